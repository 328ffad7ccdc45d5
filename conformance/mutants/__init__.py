"""Planted bugs: wrong decoders made from the second decoder. The vectors must tell each from a right one."""
