"""The bitstream: one module for each chapter or group of clauses of SPEC.md, named in the module's first line.

ARCHITECTURE.md lists them in the order of decoding. The modules import numpy, construct and `refcodec.native`. They
import neither torch nor a renderer.
"""
