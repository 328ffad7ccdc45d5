"""The native kernel: the process that decides every symbol, in C, and its binding. It is optional.

kernel.h is its interface, kernel.c and variant.h are its source. `library` loads it and says which path is used.
"""
