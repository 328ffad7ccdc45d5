"""Planted bugs: wrong decoders made from the second decoder, every one of which the vectors must tell from a right one."""
