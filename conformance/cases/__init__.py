"""The suite's cases by chapter, and the faults of files.

Each chapter of SPEC.md has a module with its valid files, refused files and faults. It has the name of the module for
the same clauses in refcodec/bitstream. Long chapters have several modules:

    header, dimensions, limits                                 the header
    directory, ancillary                                       sections, and those that a decoder skips
    weights_raw, weights_packed, weights_forms                 weights
    index, chunks, chunk_sizes                                 the index and the chunks
    entropy_values, entropy_escapes, entropy_substreams        the entropy coder

Modules for other subjects:

    order_header, order_sections   two faults in one file (10.1)
    order_weights                  two faults of the weights
    static                         static scenes: plain Gaussians (9.4)
    resource                       small files that require much memory or time (13.1)
    cameras                        Gaussians for cameras (14)
    whole                          trained and unusual scenes

A new case is an entry in the module of its chapter. A new fault is a function there, with a function that draws its
parameters (fault.py).

Helper modules:

    book, fault         definitions of a case and of a fault
    target, checksums   elements of a valid file, and repair of checksums
    targets             the valid files to which faults are applied
    scenes, cells       valid scenes and parts of them, and positions as cells
    chain               files with two faults
    samplers, numbers   invented symbols, and integers that are the same on every machine
    suite               writes files and the manifest from the cases
    features, flags     attributes of a vector in the manifest
"""

from __future__ import annotations

import json
from types import ModuleType

from ..manifest import MANIFEST, VECTORS
from .book import Book, Recipe
from .fault import FAULTS, Fault


def chapters() -> tuple[ModuleType, ...]:
    """Returns the modules with cases."""
    # The modules need the encoder, but users of the package alone do not.
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
        static,
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
        static,
        cameras,
    )


def faults() -> dict[str, Fault[...]]:
    """Returns all faults by name."""
    chapters()
    return FAULTS


def recipes() -> list[Recipe]:
    """Returns all vectors: those of the committed manifest in its order, then new ones.

    Identifiers and places of vectors are permanent, even if a case moves to another module. Raises ValueError if no
    case has an identifier of the manifest.
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
