"""The flags of vectors: each names a bug, and its text says what the decoder does wrong."""

FLAGS = {
    "final-state-unchecked": "the states are not compared with 2^16 when a substream ends",
    "tree-order-wrong": "the children of a node are taken in another order, or axes are swapped",
}
