"""Diagnosis: which rule a decoder breaks, from the vectors that it fails, and how it fails them."""
