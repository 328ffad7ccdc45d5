"""Makes vectors from recipes: files, their results by refcodec, and the manifest."""

import hashlib
import json
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from refcodec.bitstream import codec, header
from refcodec.bitstream.errors import REGISTRY, BitstreamError
from refcodec.bitstream.limits import PROFILES
from refcodec.bitstream.reconstruction import canonical_head, digest
from refcodec.files.lock import is_empty
from refcodec.files.stage import exchange, new_file
from refcodec.inspect.trace import symbol_trace
from refcodec.statuses import UsageError

from ..manifest import ARCHIVE, MANIFEST, OPERATIONS, SCHEMA, VECTORS
from .cameras import TOLERANCE, expected, reference_image
from .fault import Refused
from .features import FEATURES
from .flags import FLAGS
from .table import Recipe, Seen, path_of

NAME = "c3gs-conformance"
SUITE_VERSION = "0.1.0"
MEMORY = 256 << 20
CLASSES = ("valid", "malformed", "invalid", "unsupported", "resource")


class GeneratorError(Exception):
    """The result of a recipe differs from its description."""


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _stated(data: bytes) -> tuple[str | None, int | None]:
    """Returns the profile and level of the header, or None if it is damaged or they are unknown."""
    start, end = header.PROLOGUE_BYTES, header.PROLOGUE_BYTES + int.from_bytes(data[12:16], "little")
    if len(data) < start + 2 or end > len(data) or data[: len(header.SIGNATURE)] != header.SIGNATURE:
        return None, None
    profile, level = data[start : start + 2]
    right = zlib.crc32(data[start : end - 4]) == int.from_bytes(data[end - 4 : end], "little")
    known = profile in PROFILES and level in PROFILES[profile].levels
    return (PROFILES[profile].name.lower(), level) if right and known else (None, None)


def _accepted(recipe: Recipe, data: bytes) -> dict[str, Any]:
    lines: list[str] = []
    scene = symbol_trace(data, lines.append).scene
    if codec.emit(scene) != data:
        raise GeneratorError(f"{recipe.id}: encoding the scene does not give the file again")
    whole, parts = digest(scene)
    parts = {"head": _sha256(canonical_head(scene)), **parts}
    return {"result": "accepted", "digest": whole, "parts": parts, "trace": _sha256("".join(lines).encode())}


def _rejected(recipe: Recipe, made: Refused) -> dict[str, Any]:
    try:
        codec.parse(made.data)
    except BitstreamError as error:
        if (error.kind.name, error.offset) != (made.name, made.offset):
            stated = f"the recipe says {made.name} at {made.offset}"
            raise GeneratorError(f"{recipe.id}: {stated}, refcodec {error.kind.name} at {error.offset}") from None
    else:
        raise GeneratorError(f"{recipe.id}: {made.name} expected, refcodec accepts the file")
    kind = made.kind
    if recipe.klass not in (kind.klass, "resource"):
        raise GeneratorError(f"{recipe.id}: {made.name} is {kind.klass}")
    return {"result": "rejected", "code": kind.code, "name": made.name, "offset": made.offset, "clause": kind.clause}


def vectors(recipes: Iterable[Recipe]) -> Iterator[tuple[dict[str, Any], dict[str, bytes]]]:
    """Yields the vector of each recipe for the manifest, and its files by path. Raises GeneratorError."""
    for recipe in recipes:
        made, path = recipe.make(), path_of(recipe.id)
        files: dict[str, bytes] = {}
        if isinstance(made, Seen):
            path, data = path_of(made.id), made.data
            expectation: dict[str, Any] = {"result": made.result, "camera": made.camera}
            listed = path.replace(".c3gs", f"-{recipe.name}.{'json' if made.result == 'gaussians' else 'pfm'}")
            if made.result == "undrawn":
                proved = ["G6.5-1"]
            elif made.result == "image":
                files[listed] = reference_image(data, made.camera)
                proved = ["G14.5-1"]
            else:
                files[listed] = expected(data, made.camera)
                proved = ["G14.6-1" if "static" in recipe.features else "G14.3-1"]
            expectation |= {"path": listed, "sha256": _sha256(files[listed])} if files else {}
            expectation |= {"tolerance": TOLERANCE} if made.result == "gaussians" else {}
        elif isinstance(made, Refused):
            files[path] = data = made.data
            expectation = _rejected(recipe, made)
            proved = [made.kind.requirement, "D15.4-1", "D10.2-1", "DH-1"]
        else:
            files[path] = data = made
            expectation = _accepted(recipe, made)
            proved = ["D15.4-1", "D9.3-1", "DH-1"]
        profile, level = _stated(data)
        yield (
            {
                "id": recipe.id,
                "title": recipe.title,
                "operation": OPERATIONS.get(expectation["result"], "decode"),
                "class": recipe.klass,
                "profile": profile,
                "level": level,
                "features": list(recipe.features),
                "requirements": [*proved, *(name for name in recipe.requirements if name not in proved)],
                "flags": list(recipe.flags),
                "input": {"path": path, "size": len(data), "sha256": _sha256(data)},
                "expectation": expectation,
                **_holds_for(data, expectation),
                "budget": {"seconds": recipe.seconds, "bytes": MEMORY},
                "licence": recipe.licence,
                "generator": {"name": recipe.name.replace("-", "_"), "seed": recipe.seed},
            },
            files,
        )


# SPEC 12.3
def _holds_for(data: bytes, expectation: dict[str, Any]) -> dict[str, int]:
    """Returns the field minor_at_most of a vector, if it has it: a later minor version may give another verdict."""
    later = len(data) >= header.PROLOGUE_BYTES and int.from_bytes(data[10:12], "little") > header.MINOR
    unsupported = expectation["result"] == "rejected" and REGISTRY[expectation["name"]].klass == "unsupported"
    return {"minor_at_most": header.MINOR} if later or unsupported else {}


def _check(folder: Path) -> None:
    """Raises UsageError for a folder with something in it that is no suite."""
    if not folder.is_dir() or is_empty(folder):
        return
    manifest = folder / MANIFEST
    if not manifest.is_file() or NAME not in manifest.read_bytes()[:100].decode(errors="replace"):
        raise UsageError(f"{folder} exists and is not a conformance suite: choose another one, or empty it")


def _text(document: dict[str, Any]) -> str:
    """Returns the manifest as JSON, with a line for each vector."""
    rest = json.dumps({**document, "vectors": []}, indent=1).removesuffix("[]\n}")
    vectors = ",\n".join(f"  {json.dumps(vector)}" for vector in document["vectors"])
    return f"{rest}[\n{vectors}\n ]\n}}\n"


# The columns of an archive (vectors/README.md). The first three tell what a line is about.
COLUMNS = ("id", "sha256", "minor_at_most", "verdict", "offset", "digest", "suite_version")


def archived(text: str, rows: Iterable[dict[str, Any]]) -> str:
    """Returns an archive with a line for each vector of decoding that has none yet. No line changes, and none leaves.

    text: the archive, or nothing. Raises UsageError for a vector whose verdict differs from that of its line.
    """
    lines = {tuple(cells[:3]): cells for cells in (line.split("\t") for line in text.splitlines()[1:])}
    for vector in rows:
        if vector["operation"] == "decode":
            e = vector["expectation"]
            about = vector["id"], vector["input"]["sha256"], str(vector.get("minor_at_most", "-"))
            verdict = [str(e.get("code", "accepted")), str(e.get("offset", "-")), e.get("digest", "-")]
            line = lines.setdefault(about, [*about, *verdict, SUITE_VERSION])
            if line[3:6] != verdict:
                raise UsageError(f"{vector['id']}: {', '.join(verdict)} expected, but its line in {ARCHIVE} differs")
    return "".join("\t".join(cells) + "\n" for cells in (COLUMNS, *sorted(lines.values())))


def generate(folder: Path, recipes: Iterable[Recipe]) -> tuple[int, int]:
    """Writes the suite, and replaces that of the folder. Returns the number of vectors and bytes of files.

    Raises UsageError, before the work, if the folder contains anything else, and OSError.
    """
    _check(folder)
    rows, written = [], {}
    for vector, files in vectors(recipes):
        rows.append(vector)
        written.update(files)
    document = {"suite": NAME, "suite_version": SUITE_VERSION, "format_version": header.MAJOR}
    document |= {"flags": FLAGS, "features": FEATURES, "vectors": rows}
    size = sum(map(len, written.values()))
    written[MANIFEST] = _text(document).encode()
    written[SCHEMA] = (VECTORS / SCHEMA).read_bytes()
    # Archives begin with that of the package, as the order of the manifest does.
    kept = {f"{ARCHIVE}/{path.name}": path.read_bytes() for path in (VECTORS / ARCHIVE).glob("*.tsv")}
    own = f"{ARCHIVE}/{header.MAJOR}.tsv"
    written |= kept | {own: archived(kept.get(own, b"").decode(), rows).encode()}

    def write(new: Path) -> None:
        for klass in CLASSES:
            (new / klass).mkdir()
        for path, data in written.items():
            (new / path).parent.mkdir(parents=True, exist_ok=True)
            with new_file(new / path) as file:
                file.write(data)

    def replaced() -> list[Path]:
        _check(folder)
        return [folder / name for name in (*CLASSES, ARCHIVE, MANIFEST, SCHEMA)]

    exchange(folder, write, replaced, MANIFEST)
    return len(rows), size
