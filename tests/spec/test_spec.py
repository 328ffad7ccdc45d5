"""SPEC.md against the code: its tables are compared, its python blocks are executed and decode files."""

from __future__ import annotations

import hashlib
import importlib
import pkgutil
import re
from fractions import Fraction
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import pytest

from conformance.blocks import decode
from conformance.cases.scenes import MAIN_DIMENSIONS, TINY_DIMENSIONS, random_scene
from conformance.manifest import load
from refcodec import bitstream
from refcodec.bitstream import codec, context, directory, entropy, errors, reconstruction, syntax, tables
from refcodec.bitstream.attributes import code_attributes
from refcodec.bitstream.chunks import CHUNK_ENTRY_BYTES, chunk_ranges
from refcodec.bitstream.codec import parse_container
from refcodec.bitstream.dimensions import Dimensions, weight_count
from refcodec.bitstream.entropy import Decoder, Substream
from refcodec.bitstream.frame import MATRIX_BOUND, TRANSLATION_BOUND
from refcodec.bitstream.header import SIGNATURE, Lanes
from refcodec.bitstream.scene import Scene
from refcodec.inspect import specification
from spec import matrix
from spec.trail import trails

ROOT = Path(__file__).resolve().parents[2]
# A requirement is a line.
TEXT = specification.unfolded((ROOT / "SPEC.md").read_text(encoding="utf-8"))
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
    return [
        c
        for i, c in enumerate(cells)
        if not set(c[0]) <= {"-"} and not (i + 1 < len(cells) and set(cells[i + 1][0]) == {"-"})
    ]


SYNTAX_CLAUSES = {name: re.search(rf"^### (5\.\d+) {name}$", TEXT, re.MULTILINE) for name in syntax.SYNTAX}


@pytest.mark.parametrize("name", syntax.SYNTAX)
def test_syntax_table(name: str) -> None:
    clause = SYNTAX_CLAUSES[name]
    assert clause, f"SPEC.md has no clause 5.n {name}"
    printed = [(field, kind) for field, kind, _ in rows(section(clause[1]))[: len(syntax.SYNTAX[name])]]
    assert printed == syntax.SYNTAX[name]
    extra = [r for r in rows(section(clause[1])) if len(r) == 3]
    assert len(extra) == len(syntax.SYNTAX[name])


MODULES = [importlib.import_module(f"refcodec.bitstream.{m.name}") for m in pkgutil.iter_modules(bitstream.__path__)]


def test_constants() -> None:
    printed = rows(section("2.5"))
    assert len(printed) > 30
    for name, value, clause, _ in printed:
        expected = eval(value.replace("^", "**"))  # a formula of numbers
        found = [getattr(module, name) for module in MODULES if hasattr(module, name)]
        assert found, f"no module has {name}"
        assert all(f == expected for f in found), name
        assert re.search(rf"^#+ {re.escape(clause)} ", TEXT, re.MULTILINE), clause
        assert len(re.findall(rf"\b{name}\b", TEXT)) > 1, f"{name} is never used"


HEADINGS = set(re.findall(r"^#+ (?:Annex )?((?:\d+|[A-D])(?:\.\d+)*)[ :]", TEXT, re.MULTILINE))
PROSE = re.sub(r"^```.*?^```", "", TEXT, flags=re.DOTALL | re.MULTILINE)


def test_requirements_name_registered_errors() -> None:
    lines = re.findall(
        r"^- \[(R[^\]]+)\] It is a requirement of bitstream conformance that .*?\(`([a-z_.]+)`\)", TEXT, re.MULTILINE
    )
    ids = [i for i, _ in lines]
    assert len(ids) == len(set(ids)) == TEXT.count("] It is a requirement of bitstream conformance that")
    assert {name for _, name in lines} == set(errors.REGISTRY), (
        "each code has a requirement, and each requirement a code"
    )
    for kind in errors.REGISTRY.values():
        assert kind.clause in HEADINGS, kind
        assert kind.code // 100 in (1, 2, 3, 4, 5)


def test_every_normative_sentence_is_a_requirement() -> None:
    """Identifiers are unique and named after the clause they stand in; what obliges anyone has one."""
    found = re.findall(
        r"^- \[(([RDG])([^\]-]+)-\d+)\] It is a requirement of (bitstream|decoder|renderer) conformance that",
        TEXT,
        re.MULTILINE,
    )
    assert len({name for name, *_ in found}) == len(found) > 70
    assert all(
        {"R": "bitstream", "D": "decoder", "G": "renderer"}[letter] == what and clause in HEADINGS
        for _, letter, clause, what in found
    )
    for clause in {c for _, _, c, _ in found}:
        text = TEXT.partition("## Annex A")[2] if clause == "A" else section(clause)
        assert re.search(rf"^- \[[RDG]{re.escape(clause)}-1\]", text, re.MULTILINE), clause
    body = PROSE.replace(section("2.1"), "")
    for sentence in re.findall(r"[^.\n|]*\b(?:MUST|SHALL|REQUIRED)\b[^.\n]*", body):
        raise AssertionError(f"without an identifier: {sentence}")
    # Each function of the decoding process is named by a requirement.
    functions = set(re.findall(r"^def ([A-Z_0-9]+)\(", TEXT, re.MULTILINE))
    named = set(re.findall(r"\b[A-Z_0-9]{3,}\b", " ".join(re.findall(r"^- \[[DG].*$", TEXT, re.MULTILINE))))
    helpers = {
        "RSHIFT_ROUND",
        "CLAMP",
        "ISQRT",
        "ROUND_SCALED",
        "ROUND_F32",
        "ACTIVATION",
        "PLANE_GROUPS",
        "NOTE_SYMBOLS",
        "OPEN",
    }
    helpers |= {"RENDER_NETWORK", "NORMALISED", "LOGISTIC", "ROTATION", "PRODUCT", "PROJECT", "PIXEL"}
    assert functions - named - helpers <= {"DECODE_SCENE", "READ_TABLES"}


def test_the_matrix_has_no_holes() -> None:
    """A requirement that nothing meets is named; so is one that a vector names and SPEC.md does not have."""

    def document(text: str) -> str:
        return matrix.document(text, trails(specification.requirements(text), load()))

    new = "- [D7.99-1] It is a requirement of decoder conformance that x.\n- [D7.2-1] It"
    with pytest.raises(SystemExit, match=r"D7\.99-1 has no code in decoder in C; D7\.99-1 has no test"):
        document(TEXT.replace("- [D7.2-1] It", new))
    with pytest.raises(SystemExit, match=r"SPEC.md does not have R6\.5-1$"):
        document(TEXT.replace("- [R6.5-1]", "- [R6.55-1]"))


LARGEST = {"i32": 2**31 - 1, "i64": 2**63 - 1, "u32": 2**32 - 1, "u64": 2**64 - 1}


def test_widths() -> None:
    """Each bound of 7.11 fits its type, and needs it."""
    constants = {name: eval(value.replace("^", "**")) for name, value, *_ in rows(section("2.5"))}
    printed = rows(section("7.11"))
    assert len(printed) > 20
    for quantity, clause, bound, below, kind in printed:
        most = eval(bound.replace("^", "**"), {}, {**constants, "a": 1 << 40})
        assert most <= LARGEST[kind], quantity
        assert below == f"2^{most.bit_length()}", quantity
        smaller = {"i64": "i32", "u64": "u32"}.get(kind)
        assert smaller is None or most > LARGEST[smaller], quantity
        assert clause in HEADINGS
    assert max(tables.tables().step) <= 60097


def test_the_largest_sums_of_the_widths(spec: dict) -> None:
    """Files can reach the bounds of 7.11, or nearly."""
    matrix, shift = [MATRIX_BOUND - 1] * 9, [0] * 3
    frame = {"matrix": matrix, "translation": [TRANSLATION_BOUND - 1] * 3, "shift": shift}
    assert spec["FRAME_COORDINATES"](frame, [(1 << 40) - (1 << 29)] * 3) == [context.FRAME_CLAMP] * 3
    w = spec["CONTRACT"]([context.FRAME_CLAMP, 0, 0])
    assert (1 << 17) - 8 <= w[0] <= 1 << 17
    assert all(
        abs(x) <= 1 << 17
        for v in ([-context.FRAME_CLAMP] * 3, [1 - (1 << 30), 0, 0], [65536, 1, 0])
        for x in spec["CONTRACT"](v)
    )


def test_terms_are_defined_before_they_are_used() -> None:
    """Letters and terms are listed before the chapters that use them, each with the clause that states it.

    Names in capitals and with underscores are functions, constants and fields.
    """
    fields = {field for table in syntax.SYNTAX.values() for field, _ in table}
    letters = rows(section("3.1"))
    assert len(letters) > 10
    for letter, _, clause in letters:
        assert clause in HEADINGS
        for name in letter.split(", "):
            assert re.search(rf"\b{name}\b", section(clause)), f"{name} is not stated in {clause}"
    after = TEXT[TEXT.index("### 3.2 ") :]
    names = {name for letter, *_ in letters for name in letter.split(", ")}
    prose = re.sub(
        r"`[^`]*`|<!--.*?-->|\[[RD][^\]]*\]|^```.*?^```",
        "",
        after.partition("## Annex A")[0],
        flags=re.DOTALL | re.MULTILINE,
    )
    local = {
        "T",
        "A",
        "X",
        "Px",
        "Py",
        "Pz",
    }  # of 7.5.1, where they stand in the formula's own table, and T[n] of chapter 5
    assert set(re.findall(r"(?<![\w.+-])[A-Z](?![\w'-])", prose)) - names - local == set()
    listed = [term for term, _ in rows(section("3.2"))]
    assert len(listed) == len(set(listed)) > 25
    for term in listed:
        assert len(re.findall(rf"\b{re.escape(term)}", TEXT, re.IGNORECASE)) > 1, f"{term} is defined and never used"
    defined = set(re.findall(r"^def ([A-Z_0-9]+)\(", TEXT, re.MULTILINE))
    constants = {name for name, *_ in rows(section("2.5"))}
    constants |= {name.strip("` ") for names, *_ in rows(section("B.8")) for name in names.split(",")}
    known = (
        fields
        | defined
        | constants
        | set(syntax.SYNTAX)
        | {"BCP", "RFC", "SARM", "CARM", "PCA", "IEEE", "ISO", "CRC", "SHA", "MUST"}
    )
    for word in set(re.findall(r"\b[A-Z][A-Z0-9]+_[A-Z0-9_]+\b", PROSE)):
        assert word in known, word
    for word in set(
        re.findall(
            r"\b[a-z]{2,}_[a-z_0-9]{2,}\b",
            re.sub(r"`[^`]*`|<!--.*?-->|^\| (?:0x|\d{3} ).*$", "", PROSE, flags=re.MULTILINE),
        )
    ):
        assert word in fields | {"step_table", "carm_inputs"}, word


def test_clauses_cited_by_the_code_exist() -> None:
    for path in [*sorted((ROOT / "refcodec").rglob("*.py")), *sorted((ROOT / "conformance").rglob("*.py"))]:
        for clause in re.findall(
            r"SPEC(?:\.md)? (?:Annex )?((?:\d+|[A-D])(?:\.\d+)*)", path.read_text(encoding="utf-8")
        ):
            assert clause in HEADINGS, f"{path.name} cites {clause}"


def test_cross_references_resolve() -> None:
    cited = set(
        re.findall(
            r"(?<![\w.^-])(\d{1,2}\.\d{1,2}(?:\.\d)?)(?![\w.%])", re.sub(r"^\|.*", "", PROSE, flags=re.MULTILINE)
        )
    )
    numbers = {"1.0", "1.1", "3.875", "0.1", "2.1", "0.2", "0.01", "0.001"}
    assert len(cited) > 40
    assert cited - numbers <= HEADINGS, cited - numbers - HEADINGS
    for requirement in re.findall(r"\[([RD][0-9A][\d.]*-\d+)\]", PROSE):
        assert f"- [{requirement}] It is" in TEXT, requirement
    slugs = {
        re.sub(r"[^a-z0-9 -]", "", h.lower()).replace(" ", "-") for h in re.findall(r"^#+ (.*)$", TEXT, re.MULTILINE)
    }
    for anchor in re.findall(r"\]\(#([^)]+)\)", TEXT):
        assert anchor in slugs, anchor
    for path in re.findall(r"\]\(([^)#]+)\)", TEXT):
        assert (ROOT / path).is_file(), path


def test_tables_file_as_stated() -> None:
    data = tables.tables_file().read_bytes()
    assert hashlib.sha256(data).hexdigest() in TEXT
    assert f"of {len(data)} bytes" in TEXT


def test_the_formulas_of_the_prose(spec: dict) -> None:
    """Formulas that stand in the prose are evaluated as they are printed, and give what the functions give."""
    constants = {name: eval(value.replace("^", "**")) for name, value, *_ in rows(section("2.5"))}
    functions = {"ceil": lambda x: -int(-x // 1), "abs": abs, "min": min, **spec}
    rng = np.random.default_rng(5)

    def formulas(clause: str) -> list[str]:
        prose = re.sub(r"^```.*?^```|^\|[^\n]*|^- \[D[^\n]*", "", section(clause), flags=re.DOTALL | re.MULTILINE)
        return [f for f in re.findall(r"`([^`\n]*)`", prose) if re.search(r"[-+*/<>]", f)]

    def value(formula: str, **names: object) -> Any:
        return eval(
            formula.replace("^", "**"), {}, {**functions, **constants, "U": 1 << constants["UNIT_BITS"], **names}
        )

    def integer(bound: int) -> int:
        return int(rng.integers(1 - bound, bound)) >> int(rng.integers(0, 20))

    def called(name: str, *arguments: object) -> Any:
        return spec[name](*arguments)

    (frame_sum,) = formulas("7.5.1")
    square, inside, factor, contracted = formulas("7.5.2")
    assert "`ISQRT(q)`" in section("7.5.2")
    (rescaled,) = formulas("7.5.3")
    grid, cell, weight, sample = formulas("7.5.4")
    for _ in range(200):
        matrix, p = [integer(1 << 20) for _ in range(9)], [integer(1 << 40) for _ in range(3)]
        frame = {
            "matrix": matrix,
            "translation": [integer(1 << 61) for _ in range(3)],
            "shift": rng.integers(0, 61, 3).tolist(),
        }
        for r, v in enumerate(called("FRAME_COORDINATES", frame, p)):
            names = {f"A_r{c}": matrix[3 * r + c] for c in range(3)} | dict(zip(("Px", "Py", "Pz"), p, strict=True))
            assert v == value(frame_sum, T_r=frame["translation"][r], s_r=frame["shift"][r], **names)
        v = [integer(1 << int(rng.integers(2, 31))) for _ in range(3)]
        names = {f"v_{r}": x for r, x in enumerate(v)}
        q = value(square, **names)
        if value(inside, q=q):
            w = v
        else:
            f = value(factor, n=spec["ISQRT"](q))
            w = [value(contracted, v_r=x, f=f, n=spec["ISQRT"](q)) for x in v]
        assert w == called("CONTRACT", v)
        low = [integer(1 << 18) for _ in range(3)]
        high = [a + 1 + int(rng.integers(0, 1 << 18)) for a in low]
        u = called("RESCALE", {"low": low, "high": high}, w)
        assert u == [value(rescaled, w_r=x, low_r=a, high_r=b) for x, a, b in zip(w, low, high, strict=True)]
        s = int(rng.integers(2, 40))
        g = value(grid, u=u[0], s=s)
        c = value(cell, g=g, s=s)
        f = value(weight, g=g, c=c)
        ramp = [[[16 * j for j in range(s)] for _ in range(s)]]
        # A plane that rises along its columns shows cell and weight.
        found = called("QUERY", ramp, [u[0], 0], 0)[0]
        assert found == value(sample, sum=(c * 256 + f) * 16 * 256, plane_shift=0)
        a = {
            "origin": [integer(1 << 62)] * 3,
            "scale_mantissa": int(rng.integers(1, 65536)),
            "scale_exponent": int(rng.integers(-60, 61)),
        }
        names = {"origin": a["origin"][0], "S": a["scale_mantissa"], "P": p[0], "E": a["scale_exponent"]}
        assert value(formulas("9.1")[0], **names) == called("WORLD", a, 0, p[0])
        base = float(np.float32(rng.normal()) * np.float32(2.0) ** int(rng.integers(-40, 40)))
        mantissa, e = abs(base).as_integer_ratio()[0], 1 - abs(base).as_integer_ratio()[1].bit_length()
        while mantissa % 2 == 0:
            mantissa, e = mantissa // 2, e + 1
        y, q = integer(1 << 23), int(rng.integers(0, 64))
        step = spec["STEP"][q]
        assert value(formulas("9.2")[0], y=y, step_table=step, m=mantissa, e=e) == called("VALUE", y, q, abs(base))
        # Rounded once, so within half a unit in the last place of symbol times step.
        exact = y * value(formulas("7.8")[0], base_step=Fraction(abs(base)), step_table=step)
        assert abs(Fraction(called("VALUE", y, q, abs(base))) - exact) <= abs(exact) / (1 << 24)
    chunks, first, last = formulas("6.10")[0], *formulas("6.10")[1:3]
    for n, size in [(0, 3), (1, 3), (6, 3), (7, 3), (4096, 65536)]:
        ranges = chunk_ranges(n, size)
        assert value(chunks, N=n, chunk_size=size) == len(ranges)
        for c, held in enumerate(ranges):
            assert (value(first, c=c, chunk_size=size), value(last, c=c, chunk_size=size, N=n)) == (held[0], held[-1])
            assert "`min((c + 1) * chunk_size, N) - 1`" in section("6.10")
    data = EXAMPLE.read_bytes()
    header = parse_container(data)
    d = header.dimensions
    weights, table, positions = formulas("6.6")
    assert value(table, K=0, C=0, m=1) == syntax.SCHEMAS["PositionModel"].sizeof(at=None)
    lengths = {kind: s.end - s.start for kind, s in header.sections.items()}
    assert lengths[directory.WEIGHTS] == value(weights, carm_inputs=d.carm_inputs, W=weight_count(d))
    assert lengths[directory.CHUNK_TABLE] == value(table, K=d.offset_count, C=len(header.chunks), m=0)
    assert lengths[directory.POSITIONS] == value(positions, N=header.anchor_count)
    index, masked = formulas("7.6")
    order = [value(index, k=k, n=n) for k in range(10) for n in range(k + 1)]
    assert order == list(range(55))
    for dimensions in (TINY_DIMENSIONS, MAIN_DIMENSIONS):
        assert value(formulas("6.3")[0], F=dimensions.features, K=dimensions.offset_count) == dimensions.attribute_width
    assert value(masked, f=5) == (1 << 14) - 5
    assert value(formulas("8.5")[0], centre=7, j=3, R=5, k=4, raw=9) == 89
    assert value(formulas("8.7")[0], n=11, z=3) == 3
    assert spec["DERIVE_ROW"]([0.0, -0.0], 0.0)[2] == constants["EXPONENT_MAX"]


@pytest.mark.requirement("DA-1")
def test_the_formulas_of_annex_a() -> None:
    """Annex A's formulas, evaluated as they are printed with 50 digits, give the table file."""

    def rule(clause: str, number: int = 0) -> Any:
        code = re.findall(r"`([^`]+)`", section(clause))[number]
        names = {n: getattr(mpmath, n) for n in ("sin", "erf", "exp", "sqrt", "pi", "ln")}
        names |= {"floor": lambda x: int(mpmath.floor(x)), "ceil": lambda x: int(mpmath.ceil(x)), "max": max}
        # Numbers become exact ones, so that 1/2 and i / 8 are.
        compiled = compile(re.sub(r"\b(\d+)\b", r"N(\1)", code.replace("^", "**")), clause, "eval")
        return lambda **values: eval(compiled, {"N": mpmath.mpf, **names, **values})

    t = tables.tables()
    with mpmath.workdps(50):
        sine, step = rule("A.1"), rule("A.2")
        assert t.sine.tolist() == [sine(j=j) for j in range(1024)]
        assert t.step.tolist() == [step(q=q) for q in range(64)]
        scale, mean, gauss, laplace, gauss_radius, laplace_radius, share = (rule("A.3", n) for n in range(7))
        frequency = rule("A.4")
        for models, distribution, radius_rule in ((t.gauss, gauss, gauss_radius), (t.laplace, laplace, laplace_radius)):
            for i, f in [(-40, 0), (-40, 8), (-17, 3), (-9, 15), (0, 8), (5, 11), (23, 0), (23, 13)]:
                model = (i + 40) * 16 + f
                b, m = scale(i=i), mean(f=f)
                radius = radius_rule(b=b)
                assert models.radius[model] == radius
                found = np.diff(model_bounds(models, model)).tolist()
                right = [
                    frequency(
                        p=lambda x, d=distribution, b=b, m=m: share(G=lambda y: d(x=y, b=b), x=x, m=m), x=mpmath.mpf(x)
                    )
                    for x in range(-radius, radius + 1)
                ]
                largest = right.index(max(right))
                right[largest] += (1 << 14) - 1 - sum(right)
                assert found == [*right, 1], (i, f)


def model_bounds(models: tables.ModelSet, model: int) -> np.ndarray:
    """The slots at which the symbols of a model begin, and 2^14."""
    start, count = int(models.offset[model]), 2 * int(models.radius[model]) + 2
    return np.append(models.lower[start : start + count], 1 << 14).astype(np.int64)


def test_container_numbers() -> None:
    assert SIGNATURE.hex(" ").upper() in section("5.1")
    assert syntax.SCHEMAS["Frame"].sizeof(at=None) == 88
    assert syntax.SCHEMAS["ChunkEntry"].sizeof(at=None) == CHUNK_ENTRY_BYTES
    assert [f"{t:02X}" for t in directory.SECTIONS] == re.findall(r"^Section type (\d\d), mode 0", TEXT, re.MULTILINE)
    for kind, name in directory.SECTIONS.items():
        assert re.search(rf"\| {kind:02x} {name} ", section("4.1")), name


def test_networks_table() -> None:
    d = TINY_DIMENSIONS
    space = {
        "ch": d.plane_channels,
        "L": d.frequency_count,
        "F": d.features,
        "K": d.offset_count,
        "D": d.attribute_width,
        "hyper_width": d.hyper_width,
        "sarm_width": d.sarm_width,
        "carm_width": d.carm_width,
        "render_width": (d.render_width,),
    }
    shapes = d.network_shapes()
    printed = [r for r in rows(section("5.8")) if len(r) == 5]
    assert [r[0].split(",")[0].replace(".i", ".1") for r in printed] == list(shapes)
    for name, inputs, hidden, outputs, _ in printed:
        if name.startswith("carm"):
            assert (name, inputs, outputs) == (
                "carm.i, i = 1 to slice_count - 1",
                "sum of the widths of slices 0 to i - 1",
                "2 slice_width[i]",
            )
            fan_in, out = d.slices[0], 2 * d.slices[1]
        else:
            fan_in, out = (
                eval(re.sub(r"(\d) (?=[A-Za-z])", r"\1*", text.split(",")[0]), space) for text in (inputs, outputs)
            )
        widths = [fan_in, *space[hidden], out]
        assert shapes[name.split(",")[0].replace(".i", ".1")] == list(zip(widths[1:], widths[:-1], strict=True))


CASES = [
    (0, 0, TINY_DIMENSIONS, 1.0, 3.0),
    (1, 1, TINY_DIMENSIONS, 1.0, 3.0),
    (2, 9, TINY_DIMENSIONS, 3.0, 40.0),
    (3, 7, Dimensions(1, (1,), 1, 1, 2, (2,), (2,), (), 1), 1.0, 30000.0),
    (4, 6, Dimensions(3, (2, 1, 3), 2, 3, 5, (4, 5), (3,), (6,), 2), 0.2, 1.0),
]


@pytest.mark.requirement("D7.3-1", "D7.6-1", "D7.7-1", "D7.8-1", "D7.9-1", "D7.10-1")
@pytest.mark.parametrize(("seed", "anchors", "dimensions", "gain", "spread"), CASES)
def test_the_text_decodes_files(
    spec: dict, seed: int, anchors: int, dimensions: Dimensions, gain: float, spread: float
) -> None:
    scene = random_scene(
        seed, anchors, dimensions, chunk_size=4, lanes=Lanes(0, 1, 2), gain=gain, spread=min(spread, 5000)
    )
    data = codec.emit(scene)
    whole, verdicts = decode(spec, data, parse_container(data))
    assert hashlib.sha256(whole).hexdigest() == reconstruction.digest(codec.parse(data).scene)[0]
    assert verdicts == [None] * len(verdicts)


def test_the_text_refuses_what_the_code_refuses(spec: dict) -> None:
    """A changed byte of a substream gets the same verdict from both, checksums of the container aside."""
    scene = random_scene(8, 5, chunk_size=8, lanes=Lanes(1, 1, 1))
    data = codec.emit(scene)
    header = parse_container(data)
    part = header.sections[directory.ATTRIBUTES]
    seen = set()
    for at in range(part.start, part.end, 5):
        changed = bytearray(data)
        changed[at] ^= 0x10
        verdicts = decode(spec, bytes(changed), header)[1]
        verdict = next((v for v in verdicts if v), None)
        stream = entropy.open_substream(bytes(changed), part.start, part.end, 2, "x")
        if stream[1] is None:
            found = verdict_of_attributes(scene, stream[0])
            assert found == verdict, at
            seen.add(found)
    assert len(seen) >= 2


def verdict_of_attributes(scene: Scene, stream: Substream) -> str | None:
    """What the code says of the one attribute substream of a scene."""
    coding, decoder = codec.Coding(scene), Decoder([stream])
    code_attributes(decoder, coding.model, coding.contexts(), scene.masks, [range(scene.anchor_count)])
    error = decoder.finish()[0]
    return error.kind.name if error else None


def test_worked_example(spec: dict) -> None:
    data = EXAMPLE.read_bytes()
    assert len(data) <= 4096
    whole, _ = decode(spec, data, parse_container(data))
    assert hashlib.sha256(whole).hexdigest() == reconstruction.digest(codec.parse(data).scene)[0]
    assert codec.emit(codec.parse(data).scene) == data


def test_the_walk_is_the_file() -> None:
    """Annex D against the vector, without the code that printed it.

    The dump is its bytes. The elements, with their bytes and values, lie side by side from the first byte to the last.
    So do the raw bits.
    """
    data = EXAMPLE.read_bytes()
    dump = re.findall(r"^([0-9a-f]{8})  ([0-9a-f ]+)$", section("D.1"), re.MULTILINE)
    assert [int(at, 16) for at, _ in dump] == list(range(0, len(data), 16))
    assert b"".join(bytes.fromhex(part) for _, part in dump) == data
    end = 0
    for start, length, contents, element, value, meaning in rows(section("D.2")):
        assert int(start, 16) == end, start
        end += int(length)
        shown = bytes.fromhex(contents.strip("`").removesuffix(" ..."))
        assert data[int(start, 16) : end].startswith(shown)
        assert len(shown) == min(int(length), 12)
        assert meaning
        if re.fullmatch(r"-?\d+", value) and "low" not in element and "high" not in element:
            assert int.from_bytes(shown, "little", signed=value.startswith("-")) == int(value), element
    assert end == len(data)
    bits = rows(section("D.5"))
    last = 8 * int(bits[0][0].partition("+")[0], 16)
    for start, length, contents, meaning in bits:
        byte, bit = start.split("+")
        assert 8 * int(byte, 16) + int(bit) == last, start
        text = contents.strip("`")
        assert len(text) == int(length)
        for n, digit in enumerate(reversed(text)):
            assert data[(last + n) // 8] >> (last + n) % 8 & 1 == int(digit), start
        assert meaning
        last += int(length)
    assert last == 8 * len(data)
    states = rows(section("D.3"))
    assert all(states[i][4] == states[i - 1][9] for i in range(1, len(states)))
    # The first state stands behind the head of sub-plane 0.
    at = next(int(start, 16) for start, _, _, element, _, _ in rows(section("D.2")) if element == "planes.r1.state")
    assert int(states[0][4], 16) == int.from_bytes(data[at : at + 4], "little")
