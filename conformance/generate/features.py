"""The features of files: what a decoder must be able to do for a vector."""

FEATURES = {
    "prologue": "the twenty bytes that all versions share",
    "header": "fields of the header",
    "packed-positions": "positions in mode 1: a tree of cells for each chunk that can be packed",
    "packed-weights": "weights in mode 1: integers on grids",
    "substreams": "interleaved rANS, raw bits and escapes",
    "cameras": "the Gaussians that a camera sees",
    "container": "directory and checksums",
}
