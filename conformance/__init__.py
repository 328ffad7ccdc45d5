"""Conformance of decoders: a second decoder (`independent`), generators of files, and the comparison of decoders over them."""
