"""SPEC.md against the code: its tables are compared, its python blocks are executed and decode files."""

from __future__ import annotations

import hashlib
import importlib
import re
import struct
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from conformance.scenes import TINY_DIMENSIONS, random_scene
from refcodec import codec, container, errors, geometry, networks, reconstruction, syntax, tables
from refcodec.attributes import code_attributes
from refcodec.entropy import Decoder, Substream, select
from refcodec.scene import Dimensions, Lanes, Scene

ROOT = Path(__file__).resolve().parent.parent
TEXT = (ROOT / "SPEC.md").read_text(encoding="utf-8")
EXAMPLE = ROOT / "vectors" / "tiny-example.c3gs"


def section(number: str) -> str:
    """The text of one clause, without its subclauses of the same depth."""
    match = re.search(rf"^(#+) {re.escape(number)} .*?(?=^#{{1,4}} )", TEXT, re.DOTALL | re.MULTILINE)
    assert match, number
    return match[0]


def rows(text: str) -> list[list[str]]:
    """The body rows of the Markdown tables in a text."""
    lines = [line for line in text.splitlines() if line.startswith("|")]
    cells = [[c.strip() for c in line.strip("|").split("|")] for line in lines]
    return [c for i, c in enumerate(cells) if not set(c[0]) <= {"-"} and not (i + 1 < len(cells) and set(cells[i + 1][0]) == {"-"})]


@pytest.fixture(scope="module")
def spec() -> dict:
    """The names that SPEC.md's python blocks define."""
    space: dict = {}
    for block in re.findall(r"^```python\n(.*?)^```", TEXT, re.DOTALL | re.MULTILINE):
        exec(compile(block, "SPEC.md", "exec"), space)
    data = Path(tables.__file__).parent.joinpath("data", tables.TABLES_FILE).read_bytes()
    space["SINE"], space["STEP"], space["GAUSS"], space["LAPLACE"] = space["READ_TABLES"](data)
    return space


SYNTAX_CLAUSES = {name: re.search(rf"^### (5\.\d+) {name}$", TEXT, re.MULTILINE) for name in syntax.SYNTAX}


@pytest.mark.parametrize("name", syntax.SYNTAX)
def test_syntax_table(name: str) -> None:
    clause = SYNTAX_CLAUSES[name]
    assert clause, f"SPEC.md has no clause 5.n {name}"
    printed = [(field, kind) for field, kind, _ in rows(section(clause[1]))[: len(syntax.SYNTAX[name])]]
    assert printed == syntax.SYNTAX[name]
    extra = [r for r in rows(section(clause[1])) if len(r) == 3]
    assert len(extra) == len(syntax.SYNTAX[name])


MODULES = ["container", "codec", "networks", "planes", "attributes", "geometry", "entropy", "tables"]


def test_constants() -> None:
    printed = rows(section("2.5"))
    assert len(printed) > 30
    for name, value, clause, _ in printed:
        expected = eval(value.replace("^", "**"))  # a formula of numbers
        found = [
            getattr(importlib.import_module(f"refcodec.{m}"), name)
            for m in MODULES
            if hasattr(importlib.import_module(f"refcodec.{m}"), name)
        ]
        assert found, f"no module has {name}"
        assert all(f == expected for f in found), name
        assert re.search(rf"^#+ {re.escape(clause)} ", TEXT, re.MULTILINE), clause
        assert len(re.findall(rf"\b{name}\b", TEXT)) > 1, f"{name} is never used"


def test_generated_parts_are_current(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    module = importlib.import_module("spec")
    assert module.rewritten(TEXT) == TEXT, "run python tools/spec.py"


def test_requirements_name_registered_errors() -> None:
    lines = re.findall(r"^- \[(R[^\]]+)\] It is a requirement of bitstream conformance that .*?\(`([a-z_.]+)`\)", TEXT, re.MULTILINE)
    ids = [i for i, _ in lines]
    assert len(ids) == len(set(ids)) == TEXT.count("] It is a requirement of bitstream conformance that")
    assert {name for _, name in lines} == set(errors.REGISTRY), "each code has a requirement, and each requirement a code"
    for kind in errors.REGISTRY.values():
        assert re.search(rf"^#+ {re.escape(kind.clause)} ", TEXT, re.MULTILINE), kind
        assert kind.code // 100 in (1, 2, 3, 4, 5)


def test_clauses_cited_by_the_code_exist() -> None:
    headings = set(re.findall(r"^#+ (?:Annex )?((?:\d+|[A-D])(?:\.\d+)*)[ :]", TEXT, re.MULTILINE))
    for path in sorted((ROOT / "refcodec").rglob("*.py")):
        for clause in re.findall(r"SPEC(?:\.md)? (?:Annex )?((?:\d+|[A-D])(?:\.\d+)*)", path.read_text(encoding="utf-8")):
            assert clause in headings, f"{path.name} cites {clause}"


def test_cross_references_resolve() -> None:
    headings = set(re.findall(r"^#+ (?:Annex )?((?:\d+|[A-D])(?:\.\d+)*)[ :]", TEXT, re.MULTILINE))
    body = re.sub(r"^```.*?^```", "", TEXT, flags=re.DOTALL | re.MULTILINE)
    cited = set(re.findall(r"\((?:clause )?((?:\d+|[A-D])\.\d+(?:\.\d+)*)(?:, [^)]*)?\)", body))
    assert len(cited) > 20
    assert cited <= headings, cited - headings
    for requirement in re.findall(r"\[(R\d+\.\d+-\d+)\]", body):
        assert f"- [{requirement}] It is" in TEXT, requirement
    for anchor in re.findall(r"\]\(#([^)]+)\)", TEXT):
        slugs = {re.sub(r"[^a-z0-9 -]", "", h.lower()).replace(" ", "-") for h in re.findall(r"^#+ (.*)$", TEXT, re.MULTILINE)}
        assert anchor in slugs, anchor


def test_tables_file_as_stated() -> None:
    data = Path(tables.__file__).parent.joinpath("data", tables.TABLES_FILE).read_bytes()
    assert hashlib.sha256(data).hexdigest() in TEXT
    assert f"of {len(data)} bytes" in TEXT


def test_container_numbers() -> None:
    assert container.SIGNATURE.hex(" ").upper() in section("5.1")
    assert syntax.SCHEMAS["Frame"].sizeof(at=None) == 88
    assert syntax.SCHEMAS["ChunkEntry"].sizeof(at=None) == container.CHUNK_ENTRY_BYTES
    assert [f"{t:02X}" for t in container.SECTIONS] == re.findall(r"^Section type (\d\d), mode 0", TEXT, re.MULTILINE)
    for kind, name in container.SECTIONS.items():
        assert re.search(rf"\| {kind:02x} {name} ", section("4.1")), name


def test_networks_table() -> None:
    d = TINY_DIMENSIONS
    space = {
        "ch": d.plane_channels, "L": d.frequency_count, "F": d.features, "K": d.offset_count, "D": d.attribute_width,
        "hyper_width": d.hyper_width, "sarm_width": d.sarm_width, "carm_width": d.carm_width, "render_width": (d.render_width,),
    }  # fmt: skip
    shapes = d.network_shapes()
    printed = [r for r in rows(section("5.8")) if len(r) == 5]
    assert [r[0].split(",")[0].replace(".i", ".1") for r in printed] == list(shapes)
    for name, inputs, hidden, outputs, _ in printed:
        if name.startswith("carm"):
            fan_in, out = d.slices[0], 2 * d.slices[1]
        else:
            fan_in, out = (eval(re.sub(r"(\d) (?=[A-Za-z])", r"\1*", text.split(",")[0]), space) for text in (inputs, outputs))
        widths = [fan_in, *space[hidden], out]
        assert shapes[name.split(",")[0].replace(".i", ".1")] == list(zip(widths[1:], widths[:-1], strict=True))


def test_operators(spec: dict) -> None:
    rng = np.random.default_rng(1)
    for _ in range(300):
        a, s = int(rng.integers(-(1 << 50), 1 << 50)), int(rng.integers(0, 40))
        assert spec["RSHIFT_ROUND"](a, s) == (Fraction(a, 1 << s) + Fraction(1, 2)).__floor__()
        n, e = int(rng.integers(-(1 << 62), 1 << 62)) >> int(rng.integers(0, 60)), int(rng.integers(-60, 20))
        assert spec["ROUND_F32"](n, e) == float(reconstruction.round_to_f32(np.array([n]), e)[0])
    for mean in range(-70, 70):
        for scale in (-99, -41, -40, 0, 23, 24, 31, 32, 100, 151, 152, 900):
            row, column, centre, raw = spec["SELECT"](mean, scale)
            assert [int(x[0]) for x in select(np.array([mean]), np.array([scale]))] == [(row + 40) * 16 + column, centre, raw]


def test_geometry(spec: dict) -> None:
    rng = np.random.default_rng(2)
    scene = random_scene(5, 200)
    frame = {k: getattr(scene.frame, k).reshape(-1).tolist() for k in ("matrix", "translation", "shift", "low", "high")}
    planes = geometry.assemble_planes(scene.planes)
    bits = np.where(rng.random((200, 3)) < 0.2, rng.integers(0, 0x7C00, (200, 3)), scene.positions.view(np.uint16)).astype(np.uint16)
    code = geometry.context(scene.frame, planes, scene.plane_shift, 3, bits.view(np.float16))
    text = [spec["CONTEXT"](frame, planes[0].tolist(), planes[1].tolist(), scene.plane_shift, 3, p) for p in bits.tolist()]
    assert code.tolist() == text


def test_networks(spec: dict) -> None:
    scene = random_scene(6, 1)
    layers = scene.networks["hyper"]
    derived = [[spec["DERIVE_ROW"](w.tolist(), float(b)) for w, b in zip(*layer, strict=True)] for layer in layers]
    network = networks.IntNetwork([networks.derive_layer(*layer) for layer in layers])
    inputs = np.random.default_rng(3).integers(-1023, 1024, (50, layers[0][0].shape[1]))
    assert network(inputs).tolist() == [spec["NETWORK"](derived, row) for row in inputs.tolist()]


def decode_by_spec(spec: dict, data: bytes, header: container.Header) -> tuple[bytes, list]:
    """The canonical reconstruction of a file by SPEC.md's blocks, and the verdict on each substream.

    The container is read with the schemas; its CRC-32s are not looked at again.
    """
    h, _ = syntax.parse("Header", data, container.PROLOGUE_BYTES)
    start = {name: header.sections[kind].start for kind, name in container.SECTIONS.items()}
    frame, _ = syntax.parse("Frame", data, start["frame"])
    scales, size = syntax.parse("WeightScales", data, start["weights"])
    at = start["weights"] + size
    layers: dict = {}
    weights = b""
    for name, shapes in header.dimensions.network_shapes().items():
        layers[name] = []
        for out, fan_in in shapes:
            values = struct.unpack_from(f"<{out * (fan_in + 1)}f", data, at)
            weights += data[at : at + 4 * len(values)]
            at += 4 * len(values)
            layers[name].append(([values[r * fan_in : (r + 1) * fan_in] for r in range(out)], values[out * fan_in :]))
    table, size = syntax.parse("PlaneTable", data, start["planes"])
    at, streams = start["planes"] + size, []
    for length in table.length:
        streams.append(data[at : at + length])
        at += length
    k = header.dimensions.offset_count
    contexts = k * (k + 1) // 2
    model = struct.unpack_from(f"<{contexts}H", data, start["chunk_table"])
    chunks, at = [], {name: start[name] for name in ("positions", "masks", "attributes")}
    for number in range(len(header.chunks)):
        entry, _ = syntax.parse("ChunkEntry", data, start["chunk_table"] + 2 * contexts + 24 * number)
        part = {}
        for name, field in (("positions", "position_length"), ("masks", "mask_length"), ("attributes", "attribute_length")):
            part[name] = data[at[name] : at[name] + entry[field]]
            at[name] += entry[field]
        positions = list(struct.iter_unpack("<3H", part["positions"]))
        chunks.append((positions, part["masks"], part["attributes"]))
    all_weights = {"plane_shift": scales.plane_shift, "carm_shift": scales.carm_shift, "networks": layers}
    out, verdicts = spec["DECODE_SCENE"](h, frame, all_weights, streams, model, chunks)
    d = header.dimensions
    result = b"C3GSREC0" + struct.pack("<5I", header.anchor_count, k, d.features, d.plane_channels, d.plane_size)

    def flat(value: list) -> list:
        return [x for item in value for x in flat(item)] if value and isinstance(value[0], list) else value

    for name, code in (("positions", "f"), ("masks", "B"), ("planes", "h"), ("features", "f"), ("scalings", "f"), ("offsets", "f")):
        numbers = flat(out[name])
        result += struct.pack(f"<{len(numbers)}{code}", *numbers)
    return result + weights, verdicts


CASES = [
    (0, 0, TINY_DIMENSIONS, 1.0, 3.0),
    (1, 1, TINY_DIMENSIONS, 1.0, 3.0),
    (2, 9, TINY_DIMENSIONS, 3.0, 40.0),
    (3, 7, Dimensions(1, (1,), 1, 1, 2, (2,), (2,), (), 1), 1.0, 30000.0),
    (4, 6, Dimensions(3, (2, 1, 3), 2, 3, 5, (4, 5), (3,), (6,), 2), 0.2, 1.0),
]


@pytest.mark.parametrize(("seed", "anchors", "dimensions", "gain", "spread"), CASES)
def test_the_text_decodes_files(spec: dict, seed: int, anchors: int, dimensions: Dimensions, gain: float, spread: float) -> None:
    scene = random_scene(seed, anchors, dimensions, chunk_size=4, lanes=Lanes(0, 1, 2), gain=gain, spread=min(spread, 5000))
    data = codec.emit(scene)
    whole, verdicts = decode_by_spec(spec, data, container.parse_container(data))
    assert hashlib.sha256(whole).hexdigest() == reconstruction.digest(codec.parse(data).scene)[0]
    assert verdicts == [None] * len(verdicts)


def test_the_text_refuses_what_the_code_refuses(spec: dict) -> None:
    """A changed byte of a substream gets the same verdict from both, checksums of the container aside."""
    scene = random_scene(8, 5, chunk_size=8, lanes=Lanes(1, 1, 1))
    data = codec.emit(scene)
    header = container.parse_container(data)
    part = header.sections[container.ATTRIBUTES]
    seen = set()
    for at in range(part.start, part.end, 5):
        changed = bytearray(data)
        changed[at] ^= 0x10
        verdicts = decode_by_spec(spec, bytes(changed), header)[1]
        verdict = next((v for v in verdicts if v), None)
        stream = codec._substream(bytes(changed), part.start, part.end, 2, "x")
        if stream[1] is None:
            found = verdict_of_attributes(scene, stream[0])
            assert found == verdict, at
            seen.add(found)
    assert len(seen) >= 2


def verdict_of_attributes(scene: Scene, stream: Substream) -> str | None:
    """What the code says of the one attribute substream of a scene."""
    nets = codec.derive_networks(scene.dimensions, scene.carm_shift, scene.networks)
    contexts = nets.contexts(scene, scene.frame, geometry.assemble_planes(scene.planes), scene.plane_shift, scene.positions)
    decoder = Decoder([stream])
    code_attributes(decoder, nets.entropy, contexts, scene.masks, [range(scene.anchor_count)])
    error = decoder.finish()[0]
    return error.kind.name if error else None


def test_worked_example(spec: dict) -> None:
    data = EXAMPLE.read_bytes()
    assert len(data) <= 4096
    whole, _ = decode_by_spec(spec, data, container.parse_container(data))
    assert hashlib.sha256(whole).hexdigest() == reconstruction.digest(codec.parse(data).scene)[0]
    assert codec.emit(codec.parse(data).scene) == data
