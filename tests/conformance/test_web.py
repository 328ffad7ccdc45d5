"""The decoder in WebAssembly and JavaScript: verdicts and digests of refcodec, for all ways of reading a file."""

import hashlib
import importlib.metadata
import importlib.util
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hostile_files import FILES, GREEDY, SCENES, cuts
from web_program import MISSING, NODE, PACKAGE, PROGRAM, WEB, Decoder

from benchmarks.large import made_static
from conformance import cli
from conformance.cases.target import Target
from conformance.manifest import VECTORS
from refcodec import statuses
from refcodec.bitstream import bounds, codec, reader, reconstruction, source, tables
from refcodec.bitstream.header import read_header
from refcodec.bitstream.scene import take_anchors

# The ways in which a file can be given to `decode`.
WAYS = ["bytes", "blob", "response", "iterable", "stream"]

pytestmark = [pytest.mark.no_cover, pytest.mark.skipif(NODE is None, reason=MISSING)]


# ------------------------------------------------------------------------------------------------------- verdicts ---


@pytest.mark.slow
@pytest.mark.requirement("D15.4-1", "D9.3-1", "D10.2-3", "DH-1")
def test_it_passes_the_suite(tmp_path: Path) -> None:
    options = ["--vectors", str(VECTORS), "--jobs", "2", "--slow", "20", "--report", str(tmp_path)]
    options += ["--gaussians", f"{NODE} {PROGRAM} gaussians {{input}} {{camera}} {{output}}"]
    assert cli.main(["run", *options, "--serve", "--", str(NODE), str(PROGRAM), "serve"]) == statuses.DONE
    record = json.loads((tmp_path / "report.json").read_text())
    assert {v["status"] for v in record["vectors"] if v["operation"] != "render"} == {"passed"}


@pytest.mark.requirement("D13.1-1")
def test_a_stream_has_the_verdicts_of_a_file(decoder: Decoder) -> None:
    """test_decoders.py compares the verdicts on whole files with those of the other decoders."""
    target = Target(FILES["packed"])
    for data in (*cuts(target.data, 131), *(make(target) for make in GREEDY.values())):
        assert decoder.verdict(data, "stream", size=100) == decoder.verdict(data)


# ------------------------------------------------------------------------------------------------ ways of reading ---


@pytest.mark.requirement("D9.3-1")
@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("name", FILES)
def test_every_way_gives_the_same(decoder: Decoder, name: str, way: str) -> None:
    scene, file = SCENES[name], FILES[name]
    whole, parts = reconstruction.digest(scene)
    chunks = [
        reconstruction.chunk_digest(reader.decode_chunk(source.WholeFile(file), number))
        for number in range(Target(file).header.chunk_count)
    ]
    for size in (1, 64, 4096) if way in ("iterable", "stream") else (0,):
        assert decoder.ask(file, way, size=size) == {"scene": whole, "parts": parts, "chunks": chunks}


@pytest.mark.requirement("D10.2-1")
def test_chunks_before_a_fault_are_delivered(decoder: Decoder) -> None:
    target = Target(FILES["raw"])
    whole = decoder.ask(target.data)["chunks"]
    for chunk in range(target.header.chunk_count):
        at = target.chunk_at(chunk) + 20
        damaged = target.data[:at] + bytes([target.data[at] ^ 1]) + target.data[at + 1 :]
        answer = decoder.ask(damaged, "stream", size=50)
        assert (answer["error"]["name"], answer["error"]["offset"]) == ("chunk.crc", target.chunk_at(chunk))
        assert answer["chunks"] == whole[:chunk]


def test_a_whole_scene_at_once(decoder: Decoder) -> None:
    for name, scene in SCENES.items():
        answer = decoder.ask(FILES[name], "all")
        assert answer["scene"] == reconstruction.digest(scene)[0]
        assert answer["offsets"] == reconstruction.reconstruct(scene).offsets.astype("<f4").tobytes().hex()
        assert answer["arrays"] == ["count", "positions", "masks", "features", "scalings", "offsets"]


def test_one_chunk_by_ranges(decoder: Decoder) -> None:
    for name, file in FILES.items():
        target = Target(file)
        for number in range(target.header.chunk_count):
            answer = decoder.ask(file, "chunk", number=number)
            expected = reconstruction.reconstruct(reader.decode_chunk(source.WholeFile(file), number))
            assert answer["features"] == expected.features.astype("<f4").tobytes().hex(), name
            assert answer["positions"] == expected.positions.astype("<f4").tobytes().hex(), name
            # Neither another chunk nor an ancillary section is read.
            asked = answer["asked"]
            assert asked[0] == [0, 20]
            assert asked[-1][0] == target.chunk_at(number)
            critical = [s.start for s in target.header.sections if s.type.isupper() and s.type != b"DATA"]
            assert [start for start, _ in asked[2:-1]] == critical


def test_entries_say_where_chunks_lie(decoder: Decoder) -> None:
    scene, target = SCENES["raw"], Target(FILES["raw"])
    positions, first = reconstruction.world_positions(scene), 0
    for number, entry in enumerate(decoder.ask(target.data, "entries")["entries"]):
        own = positions[first : first + entry["count"]]
        assert (entry["number"], entry["first"], entry["start"]) == (number, first, target.chunk_at(number))
        assert np.array_equal(np.array(entry["low"], np.float32), own.min(axis=0))
        assert np.array_equal(np.array(entry["high"], np.float32), own.max(axis=0))
        first += entry["count"]
    assert first == len(positions)


# --------------------------------------------------------------------------------------------------------- bounds ---


def test_bounds_are_those_of_refcodec(decoder: Decoder) -> None:
    """The estimates of one chunk after the other, and of all anchors, are the same numbers."""
    for file in FILES.values():
        header = read_header(source.WholeFile(file))
        needed = bounds.memory_needed(header, min(header.anchor_count, header.chunk_size))
        answer = decoder.ask(file, options={"maxMemory": needed - 1})
        assert (answer["bound"], answer["needed"]) == ("memory", needed)
        assert "scene" in decoder.ask(file, options={"maxMemory": max(needed, len(file))})
        whole = bounds.memory_needed(header, min(header.anchor_count, header.chunk_size), header.anchor_count)
        answer = decoder.ask(file, "all", options={"maxMemory": whole - 1})
        assert (answer["bound"], answer["needed"]) == ("memory", whole)
        assert "scene" in decoder.ask(file, "all", options={"maxMemory": max(whole, len(file))})
        if header.anchor_count:
            answer = decoder.ask(file, options={"maxAnchors": header.anchor_count - 1})
            assert (answer["bound"], answer["needed"]) == ("anchors", header.anchor_count)


@pytest.mark.parametrize("value", ["NaN", -1, "1000", None, True, [5], {}])
@pytest.mark.parametrize("name", ["maxAnchors", "maxMemory"])
def test_bounds_that_are_none(decoder: Decoder, name: str, value: object) -> None:
    for way in ("bytes", "stream", "all", "chunk", "entries", "ancillary", "held"):
        with pytest.raises(AssertionError, match=f"TypeError: {name} must be a number of at least 0, not "):
            decoder.ask(FILES["raw"], way, options={name: value}, number=0, size=100)


# What V8 may hold beside what is counted: arrays of earlier chunks, which it frees late.
GARBAGE = 8 << 20


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="memory is read from /proc")
@pytest.mark.slow
@pytest.mark.parametrize("is_static", [False, True])
def test_what_a_function_takes_is_within_its_bound(is_static: bool, tmp_path: Path) -> None:
    """Each exported function and method is listed. The memory of the whole process is measured, less that of Node."""
    scene = codec.parse((VECTORS / "valid" / "trained-snowmiku.c3gs").read_bytes()).scene
    scene = replace(made_static(scene, 3) if is_static else scene, position_model=None)
    rows = np.resize(np.arange(scene.anchor_count), 40_000)
    (tmp_path / "many.c3gs").write_bytes(codec.emit(take_anchors(scene, rows)))

    def ask(*words: object) -> dict[str, Any]:
        line = [str(NODE), *map(str, (Path(__file__).with_name("bounds_web.mjs"), tmp_path / "many.c3gs", *words))]
        answer: dict[str, Any] = json.loads(subprocess.check_output(line))
        return answer

    listed = ask()
    assert listed["unlisted"] == []
    for name in listed["names"]:
        least = ask(name)
        assert not is_static or "bound" in least, name
        if "bound" in least:
            assert ask(name, least["bound"])["taken"] < least["bound"] + GARBAGE, name


# ----------------------------------------------------------------------------------------------------- the program ---


@pytest.mark.requirement("D10.2-3")
def test_the_program(tmp_path: Path) -> None:
    def run(*words: object) -> tuple[int, str]:
        done = subprocess.run([str(NODE), PROGRAM, *map(str, words)], capture_output=True, text=True, check=False)
        assert done.stdout == ""
        return done.returncode, done.stderr

    output = tmp_path / "output"
    assert run("decode", VECTORS / "tiny-example.c3gs", output) == (statuses.DONE, "")
    scene = codec.parse((VECTORS / "tiny-example.c3gs").read_bytes()).scene
    expected = reconstruction.digested(scene) + b"".join(part for _, part in reconstruction.canonical_parts(scene))
    assert output.read_bytes() == expected
    for folder, code, status in (("malformed", 101, statuses.REJECTED), ("unsupported", 104, statuses.UNSUPPORTED)):
        vectors = json.loads((VECTORS / "manifest.json").read_text())["vectors"]
        path = next(v["input"]["path"] for v in vectors if v["expectation"].get("code") == code)
        assert path.startswith(folder)
        verdict, stderr = run("decode", VECTORS / path, output)
        assert (verdict, json.loads(stderr)["code"]) == (status, code)
    for words in ((), ("decode",), ("encode", "a", "b"), ("decode", tmp_path / "none", output)):
        assert run(*words)[0] == statuses.USAGE
    for name, reason in (("/dev/full", "ENOSPC"), (f"{tmp_path}/none/output", "ENOENT")):
        status, stderr = run("decode", VECTORS / "tiny-example.c3gs", name)
        assert (status, stderr.startswith(f"c3gs: {name}: {reason}: ")) == (statuses.USAGE, True)


# ----------------------------------------------------------------------------------------------------- the package ---


def declared_by(name: str) -> set[str]:
    """The functions and classes that a file of types declares."""
    return set(re.findall(r"^export (?:function|class) (\w+)", (WEB / name).read_text(encoding="utf-8"), re.MULTILINE))


def test_the_types_are_those_of_the_module() -> None:
    """c3gs.d.ts declares what c3gs.js exports, and the fields that a scene and a chunk have."""
    declared = declared_by("c3gs.d.ts")
    code = "import(process.argv[1]).then((module) => console.log(JSON.stringify(Object.keys(module))))"
    done = subprocess.run(
        [str(NODE), "-e", code, WEB / "c3gs.js"], stdout=subprocess.PIPE, check=True, text=True
    ).stdout
    assert set(json.loads(done)) == declared


def test_browsers_can_load_the_module() -> None:
    """Of what c3gs.js and three.js import, nothing is Node's. The one import of Node's files is for Node alone."""
    adapters = (WEB / "adapters.js").read_text(encoding="utf-8")
    assert set(re.findall(r"^export function (\w+)", adapters, re.MULTILINE)) == declared_by("adapters.d.ts")
    todo, seen = ["c3gs.js", "three.js", "adapters.js"], set()
    while todo:
        name = todo.pop()
        seen.add(name)
        text = (WEB / name).read_text(encoding="utf-8")
        imported = re.findall(r'^(?:import|export)\b[^;]*? from "([^"]+)";', text, re.MULTILINE)
        if name == "three.js":
            imported.remove("three")
            assert set(re.findall(r"^export class (\w+)", text, re.MULTILINE)) == declared_by("three.d.ts")
        assert all(path.startswith("./") for path in imported), name
        todo += [path[2:] for path in imported if path[2:] not in seen]
    assert {"kernel.js", "container.js"} <= seen
    assert "cli.js" not in seen


def test_the_tables_lie_in_the_module() -> None:
    assert tables.tables_bytes() in (WEB / "c3gs.wasm").read_bytes()


def listed_sums() -> dict[str, str]:
    """What c3gs.wasm.sha256 says: SHA-256 by path."""
    lines = (WEB / "c3gs.wasm.sha256").read_text(encoding="utf-8").splitlines()
    return {path: digest for digest, path in (line.split(maxsplit=1) for line in lines)}


def test_the_module_was_built_from_these_sources() -> None:
    """Whoever changes a source runs `npm run build`, which writes the sums anew. This needs no compiler."""
    sources = [*WEB.glob("*.[ch]"), *(WEB.parent / "native").glob("*.[ch]"), WEB.parent / "data" / "tables-0.bin"]
    paths = [os.path.relpath(source, WEB) for source in (*sources, WEB / "c3gs.wasm")]
    assert listed_sums() == {path: hashlib.sha256((WEB / path).read_bytes()).hexdigest() for path in paths}


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("ziglang") is None, reason="ziglang, which builds c3gs.wasm, is not here")
def test_the_build_gives_the_same_bytes(tmp_path: Path) -> None:
    """The documented command, in another folder."""
    if importlib.metadata.version("ziglang") != PACKAGE["config"]["ziglang"]:
        pytest.skip(f"c3gs.wasm is built by ziglang {PACKAGE['config']['ziglang']}")
    for folder in ("web", "native", "data"):
        shutil.copytree(WEB.parent / folder, tmp_path / folder)
    (tmp_path / "web" / "c3gs.wasm").unlink()
    command = [sys.executable, *shlex.split(PACKAGE["scripts"]["build"])[1:]]
    subprocess.run(command, cwd=tmp_path / "web", check=True)
    subprocess.run(["sh", "-c", PACKAGE["scripts"]["postbuild"]], cwd=tmp_path / "web", check=True)
    for name in ("c3gs.wasm", "c3gs.wasm.sha256"):
        assert (tmp_path / "web" / name).read_bytes() == (WEB / name).read_bytes()
