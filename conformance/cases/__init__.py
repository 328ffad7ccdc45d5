"""The suite's cases by chapter, and the faults of files.

Each chapter of SPEC.md has a module with its faults and with CASES, tables of its vectors. It has the name of the
module for the same clauses in refcodec/bitstream. Long chapters have several modules:

    header, dimensions, limits                                 the header
    directory, ancillary                                       sections, and those that a decoder skips
    networks, weights_packed                                   weights
    index, chunks                                              the index and the chunks
    entropy_symbols, entropy_substreams                        the entropy coder

Modules for other subjects:

    order        two faults in one file (10.1)
    elsewhere    faults in files of a later minor version, and in those without anchors
    resource     small files that require much memory or time (13.1)
    static       static scenes: plain Gaussians (9.4)
    cameras      Gaussians for cameras (14)
    whole        trained and unusual scenes

Helper modules:

    table, fault         tables of cases, and definitions of faults
    target, checksums    elements of a valid file, and repair of checksums
    targets              the valid files to which faults are applied
    scenes, weights      valid scenes and parts of them
    samplers, numbers    invented symbols, and integers that are the same on every machine
    suite                writes files and the manifest from the cases
    features, flags      attributes of a vector in the manifest

A new case takes a row:

1. Choose the table: in CASES of the chapter's module, one with rows of the same kind. table.py has an example of each.
   A tuple between rows that does not begin with a name has what the rows after it share.
2. Add the row. Its name is the identifier without the class (`invalid-` and so on), new and permanent. Its title, a
   phrase in lower case, states the contents or the fault. What follows depends on the kind of the table:
   - `refused`: a valid file (targets.py), a fault, and its arguments. The file may be left out if it is `plain`. The
     fault gives the expected error and its offset.
   - `chain`: a fault and its arguments. Each link is a file with this fault and the next one, and the links are in the
     order of checks. A new link goes to an end; between two links, whose vector it would remove, it needs a chain of
     its own with both. `ordered`: several faults that are not neighbours.
   - `valid`: a function that returns a scene, and its arguments. Usual ones are `scene` and `only_symbols` (scenes.py)
     and `with_weights` (weights.py), for fields, symbols and weights of given values, and `drawn` (samplers.py), for
     symbols of the models.
3. Run `conformance generate -o vectors`. It fails if refcodec decides otherwise, and appends the vector to the
   manifest. Then run `pytest tests/conformance/test_vectors.py`.

A family of cases is a comprehension: a row for each field, width or rounding, such as those of `lanes` in header.py.

A fault that is not defined yet is an `element` with a wrong value, a byte of `padding`, a file that `ends` early, or a
function of some lines with the decorator `fault` (fault.py). It also says how the fuzzer and the tests draw arguments.
"""

import json
from importlib import import_module
from types import ModuleType

from refcodec.bitstream.header import MAJOR

from ..manifest import MANIFEST, VECTORS
from .fault import FAULTS, Fault
from .table import Recipe

# fmt: off
CHAPTERS = (
    "header", "limits", "dimensions", "directory", "ancillary", "weights_packed", "networks", "planes", "index",
    "chunks", "positions", "context", "attributes", "entropy_symbols", "entropy_substreams", "order", "resource",
    "whole", "static", "elsewhere", "cameras")
# fmt: on


def chapters() -> tuple[ModuleType, ...]:
    """Returns the modules with cases. They need the encoder, but users of the package alone do not."""
    return tuple(import_module(f"{__name__}.{name}") for name in CHAPTERS)


def faults() -> dict[str, Fault[...]]:
    """Returns all faults by name."""
    chapters()
    return FAULTS


def recipes() -> list[Recipe]:
    """Returns all vectors: those of the committed manifest in its order, then new ones.

    Identifiers and places of vectors are permanent, even if a case moves to another module. Only the file that had the
    version of now, and was refused before, is no vector any more. Raises ValueError if no case has an identifier of the
    manifest.
    """
    made = [recipe for chapter in chapters() for recipe in chapter.CASES]
    document = json.loads((VECTORS / MANIFEST).read_text(encoding="utf-8"))
    known = {vector["id"]: place for place, vector in enumerate(document["vectors"])}
    gone = known.keys() - {recipe.id for recipe in made} - {f"unsupported-prologue-version-{MAJOR}"}
    if gone:
        raise ValueError(f"no case has the identifiers {', '.join(sorted(gone))}, which the manifest has")
    return sorted(made, key=lambda recipe: known.get(recipe.id, len(known)))
