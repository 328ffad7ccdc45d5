"""A suite of six small files, one of each kind, and a decoder that knows the answers (fake_decoder.py)."""

import hashlib
import json
import sys
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from conformance import cli
from conformance.cases.checksums import repair
from conformance.cases.target import Target
from conformance.manifest import MANIFEST, VECTORS
from refcodec.bitstream import codec
from refcodec.bitstream.errors import BitstreamError
from refcodec.bitstream.header import MAJOR
from refcodec.bitstream.reconstruction import canonical_head, canonical_parts, digest, digested
from refcodec.bitstream.scene import Ancillary
from refcodec.inspect.trace import symbol_trace

ROOT = Path(__file__).resolve().parents[2]
FAKE = Path(__file__).with_name("fake_decoder.py")


@dataclass(frozen=True)
class Suite:
    """A small suite and the answers to it. Modes are those of fake_decoder.py."""

    folder: Path
    answers: Path

    def command(self, mode: str, *more: str) -> list[str]:
        return [sys.executable, "-S", "-E", str(FAKE), mode, str(self.answers), "{input}", "{output}", *more]

    def run(self, mode: str, *options: str, trace: bool = False) -> int:
        command = self.command(mode, *(["{trace}"] if trace else []))
        # A busy machine must not fail a test. Tests of time bounds give the option themselves.
        slow = [] if "--slow" in options else ["--slow", "20"]
        return cli.main(["run", "--vectors", str(self.folder), "--jobs", "2", *slow, *options, "--", *command])

    def report(self, mode: str, folder: Path, *options: str, trace: bool = False) -> tuple[int, dict[str, Any]]:
        status = self.run(mode, "--report", str(folder), *options, trace=trace)
        return status, json.loads((folder / "report.json").read_text())


def _files() -> dict[str, bytes]:
    scene = codec.parse((VECTORS / "tiny-example.c3gs").read_bytes()).scene
    plain, extended = (codec.emit(replace(scene, ancillary=more)) for more in ((), (Ancillary(b"noTE", 0, b"more"),)))
    target = Target(plain)
    return {
        "valid-plain": plain,
        "valid-extended": extended,
        "malformed-crc": target.put(17, bytes([plain[17] ^ 1])),
        "invalid-up-axis": repair(target.put(target.at("render_info.up_axis"), b"\6")),
        "unsupported-profile": repair(target.put(target.at("profile"), b"\7")),
        "resource-anchors": repair(target.put(target.at("anchor_count"), b"\xff\xff\xff\xff")),
    }


def _expectation(data: bytes, place: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Returns the expectation of a file in the manifest, and the fake decoder's answer."""
    lines: list[str] = []
    try:
        scene = symbol_trace(data, lines.append).scene
    except BitstreamError as error:
        kind = error.kind
        place_of = {"code": kind.code, "offset": error.offset}
        status = 2 if kind.klass == "unsupported" else 1
        expected = {"result": "rejected", "name": kind.name, "clause": kind.clause, **place_of}
        return expected, {"exit": status, "class": kind.klass, **place_of}
    output, trace = place.with_suffix(".out"), place.with_suffix(".trace")
    output.write_bytes(digested(scene) + b"".join(part for _, part in canonical_parts(scene)))
    trace.write_text("".join(lines))
    whole, parts = digest(scene)
    parts = {"head": hashlib.sha256(canonical_head(scene)).hexdigest(), **parts}
    sha = hashlib.sha256(trace.read_bytes()).hexdigest()
    expected = {"result": "accepted", "digest": whole, "parts": parts, "trace": sha}
    return expected, {"exit": 0, "output": str(output), "trace": str(trace), "extended": bool(scene.ancillary)}


def modes(good: Iterable[str], bad: Iterable[str]) -> dict[str, bytes]:
    """Returns for each mode of a decoder a valid or an invalid file with other bytes."""
    scene = codec.parse((VECTORS / "tiny-example.c3gs").read_bytes()).scene

    def marked(mode: str) -> bytes:
        return codec.emit(replace(scene, ancillary=(Ancillary(b"noTE", 0, mode.encode()),)))

    return {f"valid-{mode}": marked(mode) for mode in good} | {
        f"invalid-{mode}": repair(Target(marked(mode)).put(Target(marked(mode)).at("render_info.up_axis"), b"\6"))
        for mode in bad
    }


def build(
    folder: Path, answers: Path, files: dict[str, bytes] | None = None, budgets: dict[str, dict[str, int]] | None = None
) -> Suite:
    """Writes a suite of files (CLASS-MODE), and the answers, into two empty folders. budgets: other ones by mode."""
    vectors, known = [], {}
    for name, data in (files or _files()).items():
        klass, _, rest = name.partition("-")
        path = folder / klass / f"{rest}.c3gs"
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(data)
        expectation, answer = _expectation(data, answers / rest)
        sha = hashlib.sha256(data).hexdigest()
        known[sha] = {**answer, "mode": rest}
        profile, level = (None, None) if klass == "malformed" else ("tiny", 0)
        vectors.append(
            {
                "id": name,
                "title": rest,
                "operation": "decode",
                "class": klass,
                "profile": profile,
                "level": level,
                "features": ["header"],
                "requirements": ["R6.2-1"],
                "flags": [],
                "input": {"path": f"{klass}/{rest}.c3gs", "size": len(data), "sha256": sha},
                "expectation": expectation,
                "budget": {"seconds": 10, "bytes": 256 << 20, **(budgets or {}).get(rest, {})},
                "licence": "CC0-1.0",
                "generator": {"name": "test", "seed": 0},
            }
        )
    manifest = {"suite": "c3gs-conformance", "suite_version": "0.0.1", "format_version": MAJOR}
    manifest |= {"flags": {}, "features": {"header": "it"}, "vectors": vectors}
    (folder / MANIFEST).write_text(json.dumps(manifest))
    (answers / "answers.json").write_text(json.dumps(known))
    return Suite(folder, answers / "answers.json")
