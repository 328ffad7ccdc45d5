"""refcodec: reference encoder and decoder of the C3GS bitstream (SPEC.md, version 0)."""

__version__ = "0.1.0"
