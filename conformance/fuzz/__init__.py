"""Comparison of decoders on many generated files."""
