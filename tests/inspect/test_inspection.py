"""inspect: every byte of any input has an element, and the trace follows decoding."""

import json
import random
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from random_scenes import flipped, random_scene

from conformance.cases.checksums import repair
from conformance.cases.scenes import MAIN_DIMENSIONS, TINY_DIMENSIONS
from refcodec.bitstream import codec, syntax
from refcodec.bitstream.chunks import read_chunk
from refcodec.bitstream.codec import parse_container
from refcodec.bitstream.errors import BitstreamError
from refcodec.bitstream.header import PROLOGUE_BYTES
from refcodec.bitstream.reader import Reader
from refcodec.bitstream.reconstruction import digest
from refcodec.bitstream.scene import Ancillary
from refcodec.bitstream.source import WholeFile
from refcodec.cli.main import main
from refcodec.inspect import anchor, dump, elements, summary, trace

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def scene():
    return replace(
        random_scene(3, 40, chunk_size=16), ancillary=(Ancillary(b"noTE", 5, b"note", 4), Ancillary(b"emPT", 0, b"", 5))
    )


@pytest.fixture(scope="module")
def data(scene) -> bytes:
    return codec.emit(scene)


def verdict(data: bytes):
    try:
        return codec.parse(data)
    except BitstreamError as error:
        return error


def assert_tiled(data: bytes) -> None:
    at = 0
    for row in elements.rows(data):
        assert row.start == at < row.end, row
        at = row.end
    assert at == len(data)


def test_rows_tile_valid_files(data):
    assert_tiled(data)
    assert_tiled(codec.emit(random_scene(0, 0)))
    assert_tiled(codec.emit(random_scene(1, 300, MAIN_DIMENSIONS, chunk_size=256)))
    assert not [r for r in elements.rows(data) if r.path.endswith(", unused")]


def test_rows_name_every_header_element(data):
    header = parse_container(data)
    wanted = syntax.parse_elements("Header", data, PROLOGUE_BYTES, "header")
    listed = {r.path: r for r in elements.rows(data)}
    for element in wanted:
        row = listed[element.path]
        assert (row.start, row.end, row.value) == (element.start, element.end, element.value)
    for section in header.sections[:-2]:
        paths = [r.path for r in elements.rows(data) if section.start <= r.start < section.end]
        assert all(p.startswith(section.name) for p in paths)
    assert listed["attributes[chunk 2].symbol_crc"].kind == "u32"
    assert listed["weights.carm.1.0.weight"].kind == "f32[5,2]"


def test_nothing_raises_on_damaged_files():
    """Cut and changed at random: the rows tile the file, and every form has something to say."""
    data = codec.emit(replace(random_scene(3, 12, chunk_size=5), ancillary=(Ancillary(b"noTE", 5, b"note", 5),)))
    rng = random.Random(5)
    met = set()
    for round_number in range(300):
        changed = bytearray(data[: rng.randrange(len(data) + 1)] if round_number % 3 == 0 else data)
        for _ in range(rng.randrange(1, 4)):
            if changed:
                changed[rng.randrange(min(len(changed), 300 if rng.random() < 0.4 else len(changed)))] = rng.randrange(
                    256
                )
        damaged = bytes(changed) + bytes(rng.randrange(2) if round_number % 5 == 0 else 0)
        if round_number % 2 and len(damaged) > 300:
            # With right checksums, damage is met further in.
            damaged = repair(damaged)
        assert_tiled(damaged)
        outcome = verdict(damaged)
        error = outcome if isinstance(outcome, BitstreamError) else None
        text = list(dump.hex_lines(damaged, [error] if error else []))
        assert sum("^^ error" in line for line in text) == (error is not None)
        facts = summary.document(damaged, error or digest(outcome.scene))
        json.loads("\n".join(summary.json_lines(facts)), parse_constant=pytest.fail)
        assert list(summary.summary(facts, "x"))
        assert sum(facts["parts"].values()) == len(damaged)
        assert min(facts["parts"].values()) >= 0
        if error is not None:
            met.add(error.kind.code // 100)
            lines: list[str] = []
            with pytest.raises(BitstreamError) as raised:
                trace.trace(damaged, lines.append)
            assert raised.value.to_json() == error.to_json()
    assert met == {1, 2, 3, 4, 5}


def test_header_without_limits_is_not_believed(data):
    """Counts of 2^32 in a header cost nothing."""
    changed = bytearray(data)
    changed[24:32] = b"\xff\xff\xff\xff\x01\x00\x00\x00"
    changed[32:35] = b"\xff\xff\xff"
    assert_tiled(bytes(changed))
    for outcome in (verdict(bytes(changed)), None):
        list(summary.summary(summary.document(bytes(changed), outcome), "x"))


def test_error_stands_at_its_byte(data):
    section = parse_container(data).sections[1]
    # The section's CRC-32 is what notices; it is said where the section begins.
    damaged = flipped(data, section.start + section.length - 1)
    error = verdict(damaged)
    lines = list(dump.hex_lines(damaged, [error]))
    at = next(i for i, line in enumerate(lines) if "^^ error 312 section.crc" in line)
    assert lines[at - 1].startswith(f"{section.start:08x}")
    # A file that ends too early: at the end.
    error = verdict(data[:-3])
    lines = list(dump.hex_lines(data[:-3], [error]))
    assert "section.truncated" in lines[-1]
    assert lines[-2] == f"{len(data) - 3:08x}  end of file"
    for file, words in ((data[:-3], "NOT WHOLE"), (data + b"more", "TOO LONG")):
        for outcome in (None, verdict(file)):
            first = next(summary.summary(summary.document(file, outcome), "x"))
            assert first.endswith(f"{words}: its header states {len(data)} bytes")


def test_payloads_fold(data):
    lines = list(dump.hex_lines(data))
    assert max(len(line) for line in lines) < 160
    weights = next(line for line in lines if " weights.hyper.1.weight " in line)
    assert "..." in weights
    assert weights.endswith(" bytes")


def test_document(scene, data):
    facts = summary.document(data, digest(scene))
    assert facts["accepted"] is True
    assert facts["digest"]["whole"] == digest(scene)[0]
    assert facts["kept_offsets"] == scene.masks.sum()
    assert sum(s["bytes"] for s in facts["sections"]) == len(data)
    assert sum(s["share"] for s in facts["sections"]) == pytest.approx(1)
    reader = Reader(WholeFile(data))
    index = reader.open().index
    chunks = [read_chunk(WholeFile(data), index[number], 0) for number in range(3)]
    for part in ("positions", "masks", "attributes"):
        assert facts["parts"][part] == sum(len(getattr(chunk, part)) for chunk in chunks)
    assert sum(facts["parts"].values()) == len(data)
    assert [c["anchor_count"] for c in facts["chunks"]] == [16, 16, 8]
    assert facts["mask_model"] == scene.mask_model.tolist()
    assert facts["header"]["dimensions"]["slice_width"] == list(scene.dimensions.slices)
    assert facts["sections"][-1]["name"] == "emPT[6]"
    text = "\n".join(summary.summary(facts, "scene.c3gs"))
    assert "3 chunks of at most 16 anchors" in text
    assert text.endswith(facts["digest"]["whole"])


def test_document_of_an_empty_scene():
    data = codec.emit(random_scene(0, 0))
    facts = summary.document(data, digest(random_scene(0, 0)))
    assert list(facts["chunks"]) == []
    assert facts["sections"][0]["bits_per_anchor"] is None
    assert "accepted; digest" in "\n".join(summary.summary(facts, "empty.c3gs"))


def test_trace_is_the_decoding(scene, data):
    lines: list[str] = []
    trace.trace(data, lines.append)
    rows = [line.rstrip("\n").split("\t") for line in lines]
    assert rows[0] == ["path", "kind", "mean", "scale", "value"]
    assert all(len(row) == 5 for row in rows)
    assert len({row[0] for row in rows}) == len(rows)
    values = {row[0]: row[4] for row in rows}
    a = scene.attributes
    for i in (0, 17, 39):
        assert int(values[f"attributes.features[{i},4]"]) == a.features[i, 4]
        assert int(values[f"attributes.scalings[{i},0]"]) == a.scalings[i, 0]
        assert np.float16(values[f"positions[{i},1]"]) == scene.positions[i, 1]
        for k in range(2):
            assert int(values[f"masks[{i},{k}]"]) == scene.masks[i, k]
            if scene.masks[i, k]:
                assert int(values[f"attributes.offsets[{i},{k},2]"]) == a.offsets[i, k, 2]
            else:
                assert f"attributes.offsets[{i},{k},2]" not in values
    order = [row[0].split(".")[0].split("[")[0] for row in rows[1:]]
    stages = list(dict.fromkeys(order))
    assert stages[:5] == ["prologue", "header", "frame", "weights", "planes"]
    assert stages[5:] == ["index", "noTE", "chunk", "positions", "masks", "attributes"]
    d = TINY_DIMENSIONS
    symbols = (
        5 * d.plane_channels * d.plane_size**2
        + 40 * d.offset_count
        + 40 * (d.features + 6)
        + 3 * int(scene.masks.sum())
    )
    assert sum(row[1] in ("laplace", "gauss", "mask") for row in rows) == symbols


def test_trace_stops_at_the_error(data):
    lines: list[str] = []
    with pytest.raises(BitstreamError):
        trace.trace(flipped(data, 30), lines.append)
    assert lines[-1].startswith("header.header_crc\t")


def test_near_shows_the_elements_around_a_byte() -> None:
    """Of every byte the element, as the whole dump shows it, at most six on each side, and the error at that byte."""
    data = codec.emit(random_scene(61, 3))
    whole = list(dump.hex_lines(data))
    rows = list(elements.rows(data))
    for at in [0, 7, 8, 100, len(data) // 2, len(data) - 1]:
        lines = list(dump.hex_lines(data, near=at))
        index = next(i for i, row in enumerate(rows) if row.start <= at < row.end)
        assert lines == [whole[0], *whole[1 + max(0, index - 6) : 1 + min(len(rows), index + 7)]]
    error = BitstreamError("file.trailing", len(data), "file", "x", "y")
    assert "error 321" in list(dump.hex_lines(data, [error], len(data)))[-1]
    assert "error 321" not in "".join(dump.hex_lines(data, [error], 0))


def test_an_anchor_is_shown_as_in_the_text() -> None:
    """What SPEC.md's own blocks computed is what the command shows; the symbols are those of the scene."""
    page = (ROOT / "vectors" / "tiny-example.md").read_text(encoding="utf-8")
    table = re.search(r"<!-- generated:anchor -->\s+(.+?)\s+<!-- /generated -->", page, re.DOTALL)
    assert table
    wanted = [tuple(cell.strip() for cell in line.strip("|").split("|")) for line in table.group(1).splitlines()[2:]]
    scene = codec.parse((ROOT / "vectors" / "tiny-example.c3gs").read_bytes()).scene
    rows = list(anchor.anchor_rows(scene, 0))
    assert rows == wanted
    last = {what: values for what, _, values in anchor.anchor_rows(scene, scene.anchor_count - 1)}
    assert last["scalings: symbols"] == ", ".join(map(str, scene.attributes.scalings[-1]))
    assert last["offsets: symbols"].count("masked") == (~scene.masks[-1]).sum()
    for number in (-1, scene.anchor_count):
        with pytest.raises(IndexError):
            list(anchor.anchor_rows(scene, number))


def test_a_static_scene_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    for name, line in (
        ("static-degree-2", "render model 1, static, harmonics of degree 2"),
        ("render-model-2", "render model 2"),
    ):
        assert main(["inspect", str(ROOT / "vectors" / "valid" / f"{name}.c3gs")]) == 0
        assert f"\n{line}\n" in capsys.readouterr().out
