"""The encoder's choices (SPEC.md Annex B), from float attributes to a scene of integers.

Annex B is informative. An encoder may choose otherwise, and its files are as valid.
"""
