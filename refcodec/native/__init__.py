"""The optional native kernel: the coding of all symbols, in C, and its binding.

kernel.h is its interface; kernel.c and variant.h are its source. `library` loads it and selects the path.
"""
