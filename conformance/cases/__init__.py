"""The suite's cases, chapter by chapter, and the faults that files can have.

A chapter of SPEC.md has a file here, with its valid files, its refused ones and its faults. The file has the name of
the module of the same clauses in refcodec/bitstream. What would be too long in one file is
in several:

    header, dimensions, limits                                 the header
    directory, ancillary                                       sections, and what a decoder passes over
    weights_raw, weights_packed, weights_forms                 weights
    index, chunks, chunk_sizes                                 the index and the chunks
    entropy_values, entropy_escapes, entropy_substreams        the entropy coder

These are of no group of clauses:

    order_header, order_sections   two faults in one file (10.1)
    order_weights                  the same of weights
    resource                       small files that ask for much (13.1)
    cameras                        what cameras see (14)
    whole                          trained and unusual scenes

A new case is an entry in the file of its chapter. A new fault is a function there, with what draws its parameters
(fault.py).

The other modules help:

    book, fault         what a case is, and what a fault is
    target, checksums   a valid file and its elements, and files whose checksums are made right again
    targets             the valid files that faults are put into
    scenes, cells       valid scenes and parts of them, and positions as cells
    chain               files with two faults
    samplers, numbers   what makes symbols up, and integers that are the same everywhere
    suite               from cases to files and the manifest
    features, flags     what the manifest says of a vector
"""

from __future__ import annotations

import json
from types import ModuleType

from ..manifest import MANIFEST, VECTORS
from .book import Book, Recipe
from .fault import FAULTS, Fault


def chapters() -> tuple[ModuleType, ...]:
    """The modules with cases."""
    # What makes files needs the encoder; who asks for the package alone does not.
    from . import (  # noqa: PLC0415
        ancillary,
        attributes,
        cameras,
        chunk_sizes,
        chunks,
        context,
        dimensions,
        directory,
        entropy_escapes,
        entropy_substreams,
        entropy_values,
        frame,
        header,
        index,
        limits,
        masks,
        networks,
        order_header,
        order_sections,
        order_weights,
        planes,
        positions,
        reconstruction,
        resource,
        weights_forms,
        weights_packed,
        weights_raw,
        whole,
    )

    return (
        header,
        limits,
        dimensions,
        directory,
        ancillary,
        frame,
        weights_raw,
        weights_packed,
        weights_forms,
        networks,
        planes,
        index,
        chunks,
        chunk_sizes,
        positions,
        context,
        masks,
        attributes,
        entropy_values,
        entropy_escapes,
        entropy_substreams,
        reconstruction,
        order_header,
        order_sections,
        order_weights,
        resource,
        whole,
        cameras,
    )


def faults() -> dict[str, Fault[...]]:
    """All faults by name."""
    chapters()
    return FAULTS


def recipes() -> list[Recipe]:
    """All vectors in the order of the manifest: those of the committed one as they stand there, then the new ones.

    Identifiers are permanent, and so is the place of a vector. A case may move from file to file here, and the
    manifest stays as it is. Raises ValueError if the manifest has an identifier that no case has.
    """
    book = Book()
    for chapter in chapters():
        chapter.add(book)
    document = json.loads((VECTORS / MANIFEST).read_text(encoding="utf-8"))
    known = {vector["id"]: place for place, vector in enumerate(document["vectors"])}
    gone = known.keys() - {recipe.id for recipe in book.recipes}
    if gone:
        raise ValueError(f"no case has the identifiers {', '.join(sorted(gone))}, which the manifest has")
    return sorted(book.recipes, key=lambda recipe: known.get(recipe.id, len(known)))
