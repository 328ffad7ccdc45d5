"""The bitstream: one module for each chapter or group of clauses of SPEC.md, named in the module's first line.

    conventions     2           operators
    source          5, 10.2     the bytes of a file: in memory, as they arrive, or by ranges
    syntax          5           the syntax tables as construct schemas
    errors          10.3        the registry and the exception
    dimensions      5.3, 5.8, 6.3   dimensions, and the networks that follow from them
    limits          11          profiles and levels
    tables          A, 8.4      sine, steps, models
    header          5.1 to 5.5, 6.1 to 6.5
    directory       5.6, 6.6, 12.1
    entropy         5.15, 8
    networks        7.2
    frame           5.7, 6.7
    weights         5.8, 5.9, 6.8, 7.13
    planes          5.10, 6.9, 7.3
    index           5.11 to 5.13, 6.10
    chunks          5.14, 6.11
    positions       5.12, 6.11, 7.4, 7.12
    context         7.5
    masks           5.11, 6.12, 7.6
    attributes      6.13, 7.7 to 7.10
    reconstruction  9
    metadata        5.16, 6.14
    cameras         5.17, 6.15
    ancillary       12.1        the registry of ancillary section types
    reader          10.1, 10.2  the order of checks, for a whole file, bytes that arrive, and one chunk
    codec           7.1         decoding and encoding of whole files

These modules have no clause of their own:

    scene           the content of a file, as arrays
    kernel          the optional native kernel
    batches         chunks coded in parallel
    streaming       decoding of a file some chunks at a time
    bounds          the caller's limits on memory and work

The modules import numpy, construct and `refcodec.native`. They import neither torch nor a renderer.
"""
