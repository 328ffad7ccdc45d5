"""Changes that make no wrong decoder: for each the proof, in words, that no file tells it from the right one."""

from __future__ import annotations

PROOFS: dict[str, str] = {
    "query-corners": (
        "For g below (s - 1) U both give the cell g >> UNIT_BITS, which is at most s - 2. For g = (s - 1) U the right decoder has "
        "the cell s - 2 and the weight RSHIFT_ROUND(U, 8) = 256; the changed one has g = (s - 1) U - 1, the same cell, and the "
        "weight RSHIFT_ROUND(65535, 8) = (65535 + 128) >> 8 = 256."
    ),
    "words-past-the-end": (
        "Who reads a word past the end has taken more than word_count, and never takes one back. The first check at the end of a "
        "substream is then substream.words, at the same offset, whatever the words were; and the number of symbols has the same "
        "bound."
    ),
    "attributes.read_attributes-arithmetic-9a854d53": (
        "The number of a chunk's first anchor is used for the names in a trace alone, and no verdict or digest depends on a trace."
    ),
    "container._check_order-constant-0a10e2bf": (
        "`previous` is read for entry 7 and those behind it alone, and each of the entries 0 to 6 sets it to 0 before that."
    ),
    "entropy.RawBits.take-constant-1475cd46": (
        "The window of bytes becomes longer at its end. The field is what the lowest `count` bits behind the shift are, so that "
        "bytes behind the field's own have no part in it; past the end of the data there are none in either case."
    ),
    "entropy.RawBits.take-arithmetic-2e83862b": (
        "The window of bytes becomes longer at its end, and its further bytes are masked off: see the change of the same line to >> 2."
    ),
    "errors.C3GSError.__init__-removal-600e89d6": (
        "The text of an error is for people. Code, name, offset, class and clause are attributes that are set before it, and "
        "verdicts are made from these."
    ),
    "networks._layer-arguments-22d0ffc1": (
        "The product of two integers does not depend on their order, and map ends with the shorter of the two lists in either order."
    ),
    "operators.clamp-compare-55616b9f": ("The two differ only where value equals low; both give low there."),
    "planes._decode_plane-arguments-2d974e7c": ("max of two integers does not depend on their order."),
    "tables.parse_tables-bounds-0920fede": (
        "A row of a family becomes longer at its end. Its items are read by the column alone, a remainder modulo 16, and the "
        "first 16 are the same."
    ),
}
