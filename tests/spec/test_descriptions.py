"""The descriptions and pictures beside SPEC.md are those of its syntax tables; Kaitai Struct reads the vectors.

The compiler is looked for in the folders of NODE_PATH: `npm install kaitai-struct-compiler js-yaml`. Its library at run
time is `pip install kaitaistruct`.
"""

import importlib.util
import json
import os
import re
import shutil
import subprocess
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from conformance import spec_decoder
from refcodec.bitstream.entropy import STATE_MIN
from refcodec.bitstream.header import SIGNATURE
from refcodec.bitstream.limits import PROFILES
from refcodec.bitstream.syntax import SYNTAX, parse_elements, size_of
from refcodec.inspect import specification
from refcodec.inspect.specification import own_clauses

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "vectors" / "tiny-example.c3gs"
FOLDERS = [Path(name) for name in os.environ.get("NODE_PATH", "").split(os.pathsep) if name]
FOLDER = next((f for f in FOLDERS if (f / "kaitai-struct-compiler").exists() and (f / "js-yaml").exists()), None)
COMPILE = """
const yaml = require("js-yaml"), compiler = require("kaitai-struct-compiler"), fs = require("fs");
compiler.compile("python", yaml.load(fs.readFileSync(process.argv[1], "utf8")), null, false).then(files => {
  for (const [name, text] of Object.entries(files)) fs.writeFileSync(name, text);
});
"""


SCALARS = {f"{sign}{bits}": f"{kind}{bits // 8}" for sign, kind in (("u", "u"), ("i", "s")) for bits in (8, 16, 32, 64)}
# Kaitai Struct has no f16: these are its bits.
SCALARS |= {"f16": "u2", "f32": "f4"}
LENGTHS = {
    "lanes": "1 << lanes_log2",
    "K (K + 1) / 2": "_root.header.dimensions.offset_count * (_root.header.dimensions.offset_count + 1) / 2",
}


def snake(name: str) -> str:
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()


def keys(kind: str) -> dict[str, str]:
    """Some keys of a field of a type in the description."""
    item, _, length = kind.rstrip("]").partition("[")
    if kind == "bytes[8]":
        return {"contents": f"[{', '.join(f'0x{byte:02x}' for byte in SIGNATURE)}]"}
    if kind == "padding" or kind.startswith("bytes to "):
        return {"size": "(4 - _io.pos % 4) % 4"} if kind == "padding" else {"size-eos": "true"}
    if item == "bytes":
        return {"size": length}
    repeat = {"repeat": "expr", "repeat-expr": LENGTHS.get(length, length)} if length else {}
    return {"type": SCALARS.get(item) or snake(item), **repeat}


def test_every_table_and_field_is_described() -> None:
    """c3gs.ksy has a type for each table, with the types and the meanings of its fields."""
    text = (ROOT / "spec" / "c3gs.ksy").read_text(encoding="utf-8")
    meanings = specification.fields(specification.text())
    types = set(re.findall(r"^  (\w+):$", text, re.MULTILINE))
    for name, fields in SYNTAX.items():
        body = re.search(rf"^  {snake(name)}:\n((?:    .*\n)+)", text, re.MULTILINE)
        assert body is not None, name
        items = re.split(r"^      - id: ", body[1].partition("    seq:\n")[2], flags=re.MULTILINE)[1:]
        own = [item for item in items if not item.startswith(("further\n", "items\n"))]
        for item, (field, kind) in zip(own, fields, strict=True):
            given = dict(line.strip().split(": ", 1) for line in item.splitlines()[1:])
            wanted = keys(kind) | {"doc": json.dumps(meanings[f"{name}.{field}"][1], ensure_ascii=False)}
            assert item.partition("\n")[0] == field
            assert wanted.items() <= given.items(), (name, field)
    called = {name.partition("(")[0] for name in re.findall(r"^ +type: (\S+)$", text, re.MULTILINE)}
    assert called - types <= {"str", *SCALARS.values()}


def test_the_places_of_the_magic_file() -> None:
    header = parse_elements("Header", EXAMPLE.read_bytes(), size_of("Prologue"))
    places = {e.path: e.start for e in (*parse_elements("Prologue", EXAMPLE.read_bytes()), *header)}
    text = (ROOT / "spec" / "c3gs.magic").read_text(encoding="utf-8")
    names = ("major", "minor", *["profile"] * len(PROFILES), "level", "anchor_count", "chunk_count")
    assert [int(at) for at in re.findall(r"^>(\d+)", text, re.MULTILINE)] == [places[name] for name in names]
    assert [f"profile {p.name}" in text for p in PROFILES.values()] == [True] * len(PROFILES)
    assert SIGNATURE[1:5].decode() in text


def test_the_places_in_the_picture_of_the_layout() -> None:
    text = (ROOT / "spec" / "pictures" / "layout.svg").read_text(encoding="utf-8")
    shown = Counter(re.findall(r">([^<]+)</text>", text))
    prologue, chunk = size_of("Prologue"), size_of("Chunk")
    header = {e.path.partition(".")[0]: e.start for e in parse_elements("Header", EXAMPLE.read_bytes(), prologue)[::-1]}
    places = [0, prologue, *(header[name] for name in ("position_grid", "render_info", "dimensions"))]
    places += [*(e.start for e in parse_elements("Chunk", bytes(chunk))[:5]), chunk, 0, 4, size_of("Substream")]
    for place, count in Counter(map(str, places)).items():
        assert shown[place] >= count, place
    for field, kind in (*SYNTAX["Chunk"], *SYNTAX["Substream"]):
        assert shown[field] > 0, field
        assert shown[kind] > 0, kind


def test_the_other_pictures() -> None:
    """Their numbers are those of the clauses that they show: 7.5.2, 7.3 and 5.10, 8.3, and 7.4 to 7.10."""
    names = ("contraction", "planes", "substream", "stages")
    drawn = {name: (ROOT / "spec" / "pictures" / f"{name}.svg").read_text(encoding="utf-8") for name in names}
    texts = {name: re.findall(r">([^<]+)</text>", svg) for name, svg in drawn.items()}
    curve = max(re.findall(r'<polyline points="([^"]+)"', drawn["contraction"]), key=len)
    contract = spec_decoder.names()["CONTRACT"]
    for point in curve.split():
        x, y = map(float, point.split(","))
        # The origin and the unit of the axes, in pixels.
        before, after = (x - 70) / 90, (250 - y) / 90
        assert abs(contract([round(before * 65536), 0, 0])[0] / 65536 - after) < 1e-4
    waves = Counter(str(j + 2 * i) for i in range(6) for j in range(6))
    assert all(Counter(texts["planes"])[wave] >= count for wave, count in waves.items())
    lanes = [int(text.removeprefix("lane ")) for text in texts["substream"] if text.startswith("lane ")]
    symbols = [int(text.removeprefix("symbol ")) for text in texts["substream"] if text.startswith("symbol ")]
    assert len(symbols) > 8
    assert lanes == [symbol % 4 for symbol in symbols]
    assert f"below 2^{STATE_MIN.bit_length() - 1} " in drawn["substream"]
    assert {kind for _, kind in SYNTAX["Substream"] if not kind.startswith("bytes")} <= {*texts["substream"]}
    for clause, title in (("7.4", "position"), ("7.5.4", "planes"), ("7.5.5", "gamma"), ("7.7", "F_h")):
        assert clause in own_clauses()
        assert any(clause in text for text in texts["stages"]), clause
        assert title in texts["stages"]


@pytest.mark.slow
@pytest.mark.skipif(
    FOLDER is None or shutil.which("node") is None, reason="kaitai-struct-compiler and js-yaml are not in NODE_PATH"
)
@pytest.mark.skipif(importlib.util.find_spec("kaitaistruct") is None, reason="kaitaistruct is not installed")
def test_kaitai_struct_reads_the_vectors(tmp_path: Path) -> None:
    """Every element of prologue and header has refcodec's value, and every valid file is read to its end."""
    subprocess.run(["node", "-e", COMPILE, ROOT / "spec" / "c3gs.ksy"], cwd=tmp_path, check=True)
    spec = importlib.util.spec_from_file_location("c3gs", tmp_path / "c3gs.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    # Those with a damaged ancillary section, which decoders ignore, are left out.
    paths = [p for p in sorted((ROOT / "vectors" / "valid").glob("*.c3gs")) if "-broken-" not in p.name]
    assert len(paths) > 300
    for path in paths:
        data = path.read_bytes()
        parsed = module.C3gs.from_bytes(data)
        assert parsed._io.pos() == len(data), path.name
        for name, start in (("Prologue", 0), ("Header", size_of("Prologue"))):
            for element in parse_elements(name, data, start):
                if element.kind == "padding" or element.path in ("signature", "header_crc"):
                    continue
                value = at(getattr(parsed, name.lower()), element.path)
                wanted = element.value.decode("latin-1") if element.path.endswith(".type") else element.value
                assert value == wanted, f"{path.name}: {element.path}"


def at(value: Any, path: str) -> Any:
    """What lies at a path such as directory[0].type."""
    for word in re.findall(r"\w+", path):
        value = value[int(word)] if word.isdigit() else getattr(value, word)
    return value
