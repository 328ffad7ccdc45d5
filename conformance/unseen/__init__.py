"""Bugs that no table has: wrong decoders for a diagnosis that has never seen them, and how often it is right."""
