"""Changes that make no wrong decoder: for each the proof, in words, that no file tells it from the right one."""

from __future__ import annotations

PROOFS: dict[str, str] = {
    "query-corners": (
        "For g below (s - 1) U both give the cell g >> UNIT_BITS, which is at most s - 2. For g = (s - 1) U the "
        "right decoder has the cell s - 2 and the weight RSHIFT_ROUND(U, 8) = 256. The changed one has g = (s - 1) U "
        "- 1, the same cell, and the weight RSHIFT_ROUND(65535, 8) = (65535 + 128) >> 8 = 256."
    ),
    "words-past-the-end": (
        "Who reads a word past the end has taken more than word_count, and never takes one back. The first check at "
        "the end of a substream is then substream.words, at the same offset, whatever the words were. The number of "
        "symbols has the same bound."
    ),
    "chunks.ChunkReader.read-logic-0e9c5b94": (
        "A chunk in form 1 is refused before, at its head, if there is no model of positions. So where the form is 1, "
        "there is a model."
    ),
    "context.ContextSource._unit_coordinates-compare-0901d55f": (
        "The two differ only where the square is U^2. Then the norm is U, the factor (2 U - U) U // U = U, and each "
        "coordinate x U // U = x: what the right decoder keeps."
    ),
    "conventions.clamp-compare-2c9a8fb7": "The two differ only where value equals low; both give low there.",
    "conventions.f32_bits-arithmetic-0b419160": (
        "The significand is 2^23 in place of 2^24, or 0. Of either the lowest 23 bits are taken, which are 0 in both."
    ),
    "errors.C3GSError.__init__-removal-639a7319": (
        "The text of an error is for people. Verdicts are made from code, name, offset, class and clause, attributes "
        "that are set before it."
    ),
    "planes._decode_plane-removal-0a220aaa": (
        "The results of SARM are kept by its inputs, and a result is the same whether it is kept or computed. Memory "
        "alone grows: by one entry for each symbol of a sub-plane at most, of which a file of the suite has few."
    ),
    "planes._decode_plane-compare-29c30379": (
        "What is forgotten is computed again, to the same result: a result of SARM depends on its inputs alone. Time "
        "and memory alone differ."
    ),
    "planes._decode_plane-arguments-2dae30df": "min of two integers does not depend on their order.",
    "syntax.Fields.read-constant-36a87389": (
        "A field that is no list is read as one item. So the first item and the last one are the same."
    ),
    "tables.parse_tables-removal-049093c9": (
        "The check is of the decoder's own file of tables, which is the right one. No file to be decoded changes it."
    ),
}
