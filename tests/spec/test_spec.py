"""SPEC.md against the code: its tables are compared, its python blocks are executed and decode files."""

import ast
import builtins
import hashlib
import importlib
import json
import math
import pkgutil
import re
import struct
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from functools import cache
from itertools import accumulate, product
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import pytest
from random_scenes import random_scene

from conformance import spec_decoder
from conformance.cases.scenes import CONSTANT, MAIN_DIMENSIONS, PLANELESS, TINY_DIMENSIONS, UNENCODED
from conformance.manifest import load
from refcodec import bitstream
from refcodec.bitstream import ancillary, codec, directory, errors, reconstruction, syntax, tables
from refcodec.bitstream.attributes import Attributes
from refcodec.bitstream.chunks import chunk_ranges
from refcodec.bitstream.dimensions import Dimensions, weight_count, work
from refcodec.bitstream.frame import Frame
from refcodec.bitstream.header import SIGNATURE, Lanes, PositionGrid, RenderInfo
from refcodec.bitstream.index import ENTRY_BYTES
from refcodec.bitstream.limits import FEATURES_MAX, PROFILES
from refcodec.bitstream.positions import PositionModel
from refcodec.bitstream.scene import Ancillary, Scene, take_anchors
from refcodec.inspect import specification
from spec import citations, matrix
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
    cells = [[c.strip() for c in re.split(r"(?<!\\)\|", line.removeprefix("|").removesuffix("|"))] for line in lines]
    return [
        c
        for i, c in enumerate(cells)
        if not set(c[0]) <= {"-"} and not (i + 1 < len(cells) and set(cells[i + 1][0]) == {"-"})
    ]


def generated(name: str) -> str:
    """A generated part of the page that explains the worked example."""
    page = EXAMPLE.with_suffix(".md").read_text(encoding="utf-8")
    return re.search(rf"<!-- generated:{name} -->(.*?)<!-- /generated -->", page, re.DOTALL)[1]


def value(formula: str, **names: object) -> Any:
    """The value of a formula as SPEC.md prints it, with the constants of 2.5."""
    return eval(formula.replace("^", "**"), {}, {**CONSTANTS, **names})


def without_code(text: str) -> str:
    return re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)


CONSTANTS: dict[str, int] = {}
CONSTANTS |= {name: value(printed) for name, printed, *_ in rows(section("2.5"))}
SYNTAX_CLAUSES = {name: re.search(rf"^###+ (5[.\d]+) {name}$", TEXT, re.MULTILINE) for name in syntax.SYNTAX}


@pytest.mark.parametrize("name", syntax.SYNTAX)
def test_syntax_table(name: str) -> None:
    clause = SYNTAX_CLAUSES[name]
    assert clause, f"SPEC.md has no clause 5.n {name}"
    # Tables of other things have more or fewer columns.
    assert [tuple(row[:2]) for row in rows(section(clause[1])) if len(row) == 3] == syntax.SYNTAX[name]


MODULES = [importlib.import_module(f"refcodec.bitstream.{m.name}") for m in pkgutil.iter_modules(bitstream.__path__)]


def test_constants() -> None:
    printed = rows(section("2.5"))
    assert len(printed) > 30
    for name, _, clause, _ in printed:
        values = [getattr(module, name) for module in MODULES if hasattr(module, name)]
        assert values, f"no module has {name}"
        assert all(f == CONSTANTS[name] for f in values), name
        assert re.search(rf"^#+ {re.escape(clause)} ", TEXT, re.MULTILINE), clause
        assert len(re.findall(rf"\b{name}\b", TEXT)) > 1, f"{name} is never used"


HEADINGS = set(re.findall(r"^#+ (?:Annex )?((?:\d+|[A-H])(?:\.\d+)*)[ :]", TEXT, re.MULTILINE))
PROSE = without_code(TEXT)


def clause_texts() -> dict[str, str]:
    """The text of each clause outside code and generated parts."""
    bare = re.sub(r"<!-- generated.*?/generated -->", "", TEXT, flags=re.DOTALL)
    return {number: without_code(clause.text) for number, clause in specification.clauses(bare).items()}


def test_each_error_is_stated_once() -> None:
    """A requirement is the only place of a rule: it names its error, and its words and the registry agree on it."""
    stated = specification.requirements(TEXT)
    assert {r.id: r.error for r in stated.values() if r.error} == {
        kind.requirement: kind.name for kind in errors.REGISTRY.values()
    }
    for kind in errors.REGISTRY.values():
        words = re.search(rf"^- \[{kind.requirement}\].*", TEXT, re.MULTILINE)[0]
        assert ("not supported" in words) == (kind.klass == "unsupported"), kind
        assert kind.clause in HEADINGS, kind
        assert kind.code // 100 in (1, 2, 3, 4, 5)
    for number, text in clause_texts().items():
        prose = re.sub(r"^- \[R.*$", "", text, flags=re.MULTILINE)
        cited = {name for name in re.findall(r"`([a-z_]+\.[a-z_]+)`", prose) if name in errors.REGISTRY}
        # What a decoder of some profiles and levels reports of the others.
        assert cited == ({"header.profile", "header.level"} if number == "15.4" else set()), number


def test_constants_are_named_and_not_repeated() -> None:
    """Normative prose names a large constant. 7.11 and Annex A have formulas."""
    # 2^24 is also that of binary32, and the length of metadata has no name.
    others = {("7.2", "2^24"), ("9.2", "2^24"), ("6.14", "65,536")}
    texts = {n: t for n, t in clause_texts().items() if n[0] not in "BCDEFG" and n not in ("2.5", "7.11", "A.1", "A.3")}
    for name, printed, *_ in rows(section("2.5")):
        constant = CONSTANTS[name]
        if abs(constant) < 1000:
            continue
        forms = "|".join(map(re.escape, (printed, str(constant), f"{constant:,}")))
        for number, text in texts.items():
            repeated = re.findall(rf"(?<![\w.,^*+-])(?:{forms})(?![\w.^,])", text)
            assert {(number, form) for form in repeated} <= others, (name, number, repeated)


def test_every_normative_sentence_is_a_requirement() -> None:
    """Identifiers are unique and named after the clause they stand in; what obliges anyone has one."""
    listed = re.findall(r"^- \[(([RDGE])([^\]-]+)-\d+)\] (.*)$", TEXT, re.MULTILINE)
    assert len({name for name, *_ in listed}) == len(listed) > 70
    for name, letter, clause, sentence in listed:
        assert clause in HEADINGS, name
        assert "MUST" in sentence.partition(". ")[0], name
        assert (letter == "R") == bool(re.search(r"\(`[a-z_]+\.[a-z_]+`\)", sentence)), name
    for clause in {c for _, _, c, _ in listed}:
        text = TEXT.partition(f"## Annex {clause}")[2] if clause.isalpha() else section(clause)
        assert re.search(rf"^- \[[RDGE]{re.escape(clause)}-1\]", text, re.MULTILINE), clause
    body = re.sub(r"^- \[[RDGE].*$", "", PROSE.replace(section("2.1"), ""), flags=re.MULTILINE)
    for sentence in re.findall(r"[^.\n|]*\b(?:MUST|SHALL|REQUIRED)\b[^.\n]*", body):
        raise AssertionError(f"without an identifier: {sentence}")
    # A requirement names each function of the blocks, or one that uses it.
    code = re.findall(r"^```python\n(.*?)^```", TEXT, re.DOTALL | re.MULTILINE)
    bodies = dict(re.findall(r"^def ([A-Z_0-9]+)\((.*?)(?=^\S|\Z)", "\n".join(code), re.DOTALL | re.MULTILINE))
    assert len(bodies) > 60
    sentences = " ".join(re.findall(r"^- \[[DGE].*$", TEXT, re.MULTILINE))
    met = set(re.findall(r"\b[A-Z_0-9]{3,}\b", sentences)) & set(bodies)
    while new := {f for name in met for f in re.findall(r"\b[A-Z_0-9]+\b", bodies[name]) if f in bodies} - met:
        met |= new
    # Tables are made before anything is decoded.
    assert set(bodies) - met <= {"READ_TABLES", "CRC_ENTRY"}


def test_the_order_of_checks_is_whole() -> None:
    """10.1 names each requirement on files, in the order of the file as far as a number tells it."""
    order = section("10.1")
    named = set()
    for first, last in re.findall(r"\[(R[\d.]+-\d+)\](?: to \[(R[\d.]+-\d+)\])?", order):
        clause, _, number = first.rpartition("-")
        assert not last or last.rpartition("-")[0] == clause
        end = int((last or first).rpartition("-")[2])
        named |= {f"{clause}-{n}" for n in range(int(number), end + 1)}
    assert named == {kind.requirement for kind in errors.REGISTRY.values()}
    # FIELDS is in the order of the codes.
    step = re.search(r"^- FIELDS.*?(?=^- DIRECTORY)", order, re.DOTALL | re.MULTILINE)[0]
    codes = {kind.requirement: kind.code for kind in errors.REGISTRY.values()}
    ordered = [codes[name] for name in re.findall(r"R[\d.]+-\d+", step)]
    assert ordered == sorted(ordered)
    assert len(ordered) == 12


def test_the_matrix_has_no_holes() -> None:
    """A requirement that nothing meets is named; so is one that a vector names and SPEC.md does not have."""

    def record(text: str) -> str:
        return matrix.record(trails(specification.requirements(text), load()))

    new = "- [D7.99-1] It MUST be x.\n- [D7.2-1] The"
    with pytest.raises(SystemExit, match=r"D7\.99-1 has no code in decoder in C; D7\.99-1 has no test"):
        record(TEXT.replace("- [D7.2-1] The", new))
    with pytest.raises(SystemExit, match=r"SPEC.md does not have R6\.5-1$"):
        record(TEXT.replace("- [R6.5-1]", "- [R6.55-1]"))


LARGEST = {"i32": 2**31 - 1, "i64": 2**63 - 1, "u32": 2**32 - 1, "u64": 2**64 - 1}


def test_widths() -> None:
    """Each bound of 7.11 fits its type, and needs it."""
    printed = rows(section("7.11"))
    assert len(printed) > 20
    for quantity, clause, bound, below, kind in printed:
        most = value(bound, a=1 << 40)
        assert most <= LARGEST[kind], quantity
        assert below == f"2^{most.bit_length()}", quantity
        smaller = {"i64": "i32", "u64": "u32"}.get(kind)
        assert smaller is None or most > LARGEST[smaller], quantity
        assert clause in HEADINGS
    assert max(tables.tables().step) <= 60097
    # The most rows and the most inputs of a layer.
    networks = replace(largest_main(), view_inputs=0).network_shapes().values()
    shapes = [shape for layers in networks for shape in layers]
    assert max(rows for rows, _ in shapes) == 768
    assert max(inputs for _, inputs in shapes) == 128


def largest_main() -> Dimensions:
    """The dimensions of Main with the most weights: early slices are large, because all later networks read them."""
    main = PROFILES[1]

    @cache
    def best(networks: int, features: int) -> tuple[int, tuple[int, ...]]:
        """The most weights of the layers of CARM that depend on the slices, and the widths of these."""
        if networks == 0:
            return 0, ()
        widths = range(1, min(64, FEATURES_MAX - features - networks + 1) + 1)
        choices = ((best(networks - 1, features + w), w) for w in widths)
        return max((rest[0] + 128 * features + 129 * 2 * w, (w, *rest[1])) for rest, w in choices)

    slices = max(((w, *best(15, w)[1]) for w in range(1, 65)), key=lambda s: best(15, s[0])[0])
    top = {name: getattr(main, name)[1] for name in vars(main) if isinstance(getattr(main, name), tuple)}
    widths = [(top[f"{name}_width"],) * top[f"{name}_layers"] for name in ("hyper", "sarm", "carm")]
    return Dimensions(
        top["offset_count"], slices, top["plane_channels"], top["frequency_count"], top["plane_size"], *widths,
        top["render_width"], top["view_inputs"], top["colour_outputs"],
    )  # fmt: skip


def test_the_figures_of_security() -> None:
    """13.1's memory, and the manual's times, from formulas and the largest dimensions of Main. 7.11 has the work."""
    d = largest_main()
    assert d.features == FEATURES_MAX
    names = {
        "W": weight_count(d), "ch": d.plane_channels, "B": d.plane_size, "C": 1, "n": 1, "D": d.attribute_width,
        "K": d.offset_count, "L": d.frequency_count,
    }  # fmt: skip
    printed = {stage: (formula, stated) for stage, formula, stated in rows(section("13.1"))}

    def memory(stage: str) -> int:
        return int(value(re.sub(r"(?<=[\w)]) (?=[\w(])", "*", printed[stage][0]), **names))

    for stage in ("weights, as f32 and as integers of 32 bits", "planes"):
        assert printed[stage][1] == f"{memory(stage) / 1e6:.1f} MB"
    chunk = PROFILES[1].chunk_size[1]
    assert printed["one chunk, as it is decoded"][1] == (
        f"{memory('one chunk, as it is decoded') * chunk / 1e6:.1f} MB, with {chunk:,} anchors"
    )
    assert printed["values of one chunk"][1] == f"{memory('values of one chunk') * chunk / 1e6:.1f} MB"
    each = printed["Gaussians of one chunk of a static scene"]
    assert each[1] == f"{chunk * d.offset_count * (44 + 4 * d.colour_outputs) / 1e6:.1f} MB"
    text = " ".join(section("13.1").split())
    highest = max(PROFILES[1].levels)
    anchors = PROFILES[1].levels[highest].anchors
    assert f"this is at most {memory('values of one chunk') * anchors / 1e9:.1f} GB, at level {highest}" in text
    paper = 12 + 10 + 4 * MAIN_DIMENSIONS.attribute_width
    assert f"With the dimensions of CAT-3DGS it is {paper * anchors / 1e9:.1f} GB" in text
    manual = " ".join((ROOT / "docs" / "look-inside.md").read_text(encoding="utf-8").split())
    seconds = [level.work / 1e9 for level in PROFILES[1].levels.values()]
    times = [f"{s:.0f} s" if s < 600 else f"{s / 60:.0f} minutes" for s in seconds]
    more = 96 * names["W"] + (2 * 16 + 16) * 16 * anchors
    assert f"take at most {', '.join(times[:-1])} and {times[-1]}, and up to {more / 1e9:.0f} s more" in manual
    splat = 16 * anchors * d.offset_count * (11 + d.colour_outputs) / 1e9 / 60
    assert f"Gaussians of a static scene take up to {splat:.0f} minutes more" in manual
    assert f"A file of {anchors / 16 / 1e6 + 44 * anchors / chunk / 1e6:.1f} MB" in text
    bound = next(bound for quantity, _, bound, *_ in rows(section("7.11")) if quantity == "work")
    assert value(bound) == work(replace(d, view_inputs=0), anchors)


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
        r"`[^`]*`|<!--.*?-->|\[[RDGE][^\]]*\]", "", without_code(after.partition("## 16 ")[0]), flags=re.DOTALL
    )
    # Of 7.5.1, where they stand in the formula's own table, of T[n] in chapter 5, of 6.6, which counts letters, and of
    # ITU-T H.273.
    local = {"T", "A", "X", "Px", "Py", "Pz", "Z", "H"}
    assert set(re.findall(r"(?<![\w.+-])[A-Z](?![\w'-])", prose)) - names - local == set()
    listed = re.findall(r"\*\*(.+?)\*\*", section("3.2"))
    assert len(listed) == len(set(listed)) > 60
    for term in listed:
        assert len(re.findall(rf"\b{re.escape(term)}", TEXT, re.IGNORECASE)) > 1, f"{term} is defined and never used"
    defined = set(re.findall(r"^def ([A-Z_0-9]+)\(", TEXT, re.MULTILINE))
    capitals = set(re.findall(r"\b[A-Z][A-Z0-9]+_[A-Z0-9_]+\b", PROSE))
    assert capitals - fields - defined - CONSTANTS.keys() - set(syntax.SYNTAX) == set()
    bare = re.sub(r"`[^`]*`|<!--.*?-->|^\| (?:0x|\d{3} ).*$", "", PROSE, flags=re.MULTILINE)
    assert set(re.findall(r"\b[a-z]{2,}_[a-z_0-9]{2,}\b", bare)) - fields == {"step_table", "carm_inputs"}


def test_cross_references_resolve() -> None:
    """tests/docs/test_links.py follows the links."""
    chapters = re.sub(r"^\|.*", "", PROSE.partition("## 16 ")[0], flags=re.MULTILINE)
    cited = set(re.findall(r"(?<![\w.^-])(\d{1,2}\.\d{1,2}(?:\.\d)?)(?![\w.%])", chapters))
    # Annexes have figures, too. There clauses are looked for in brackets.
    cited |= set(re.findall(r"\((\d{1,2}\.\d{1,2}(?:\.\d)?)\)", PROSE.partition("## Annex A")[2]))
    cited |= set(re.findall(r"(?<![\w.-])([A-H]\.\d)(?![\w.])", PROSE)) - {"D.6"}
    numbers = {"1.0", "1.1", "0.1", "0.2", "0.01", "0.001", "50.7", "24.6", "4.4"}
    assert len(cited) > 60
    assert cited - numbers <= HEADINGS, cited - numbers - HEADINGS
    for requirement in re.findall(r"\[([RD][0-9A][\d.]*-\d+)\]", PROSE):
        assert f"\n- [{requirement}] " in TEXT, requirement


def test_the_formulas_of_the_prose(spec: dict) -> None:
    """Formulas that stand in the prose are evaluated as they are printed, and give what the functions give."""
    functions = {"ceil": math.ceil, "floor": math.floor, "abs": abs, "min": min, "U": 1 << CONSTANTS["UNIT_BITS"]}
    evaluated = set()
    rng = np.random.default_rng(5)

    def formulas(clause: str) -> list[str]:
        prose = re.sub(r"^\|.*|^- \[D.*", "", without_code(section(clause)), flags=re.MULTILINE)
        return [f for f in re.findall(r"`([^`\n]*)`", prose) if re.search(r"[-+*/%&|<>]", f)]

    def value_of(formula: str, **names: object) -> Any:
        evaluated.add(formula)
        return value(formula, **{**spec, **functions, **names})

    def integer(bound: int) -> int:
        return int(rng.integers(1 - bound, bound)) >> int(rng.integers(0, 20))

    def called(name: str, *arguments: object) -> Any:
        return spec[name](*arguments)

    (frame_sum,) = formulas("7.5.1")
    square, inside, factor, contracted = formulas("7.5.2")
    assert "`ISQRT(q)`" in section("7.5.2")
    (rescaled,) = formulas("7.5.3")
    grid, cell, weight, sample = formulas("7.5.4")
    phase, turn, sine, cosine = formulas("7.5.5")
    (rounded,) = [f for f in formulas("2.4") if "floor" in f]
    (scaled,) = formulas("7.2")
    row, centred, *found_at, symbol = formulas("8.5")
    power, fraction, term = formulas("9.4")
    (listed,) = re.findall(r"EXP2 is ([\d, \n]+):", section("9.4"))
    *lower, highest = map(int, listed.split(","))
    for _ in range(200):
        t = int(rng.integers(-CONSTANTS["SCALING_BOUND"], CONSTANTS["SCALING_BOUND"] + 1))
        y, m = t * CONSTANTS["LOG2_E"], highest
        for coefficient in reversed(lower):
            m = coefficient + value_of(term, m=m, f=value_of(fraction, y=y))
        assert called("EXPONENTIAL", t) == (m, value_of(power, y=y))
        matrix, p = [integer(1 << 20) for _ in range(9)], [integer(1 << 40) for _ in range(3)]
        frame = {"matrix": matrix, "translation": [integer(1 << 61) for _ in range(3)]}
        frame |= {"shift": rng.integers(0, 61, 3).tolist()}
        for c, v in enumerate(called("FRAME_COORDINATES", frame, p)):
            names = {f"A_c{i}": matrix[3 * c + i] for i in range(3)} | dict(zip(("Px", "Py", "Pz"), p, strict=True))
            assert v == value_of(frame_sum, T_c=frame["translation"][c], s_c=frame["shift"][c], **names)
        v = [integer(1 << int(rng.integers(2, 31))) for _ in range(3)]
        names = {f"v_{c}": x for c, x in enumerate(v)}
        q = value_of(square, **names)
        if value_of(inside, q=q):
            w = v
        else:
            f = value_of(factor, n=spec["ISQRT"](q))
            w = [value_of(contracted, v_c=x, f=f, n=spec["ISQRT"](q)) for x in v]
        assert w == called("CONTRACT", v)
        low = [integer(1 << 18) for _ in range(3)]
        high = [a + 1 + int(rng.integers(0, 1 << 18)) for a in low]
        u = called("RESCALE", {"low": low, "high": high}, w)
        assert u == [value_of(rescaled, w_c=x, low_c=a, high_c=b) for x, a, b in zip(w, low, high, strict=True)]
        s = int(rng.integers(2, 40))
        g = value_of(grid, u=u[0], s=s)
        c = value_of(cell, g=g, s=s)
        f = value_of(weight, g=g, c=c)
        ramp = [[[16 * j for j in range(s)] for _ in range(s)]]
        # A plane that rises along its columns shows cell and weight.
        result = called("QUERY", ramp, [u[0], 0], 0)[0]
        assert result == value_of(sample, sum=(c * 256 + f) * 16 * 256, plane_shift=0)
        for k in range(16):
            t = value_of(turn, phase=value_of(phase, u_2=u[0], k=k))
            entries = value_of(sine, t=t), value_of(cosine, t=t)
            assert [spec["SINE"][at] for at in entries] == called("GAMMA", u[0], 16)[2 * k : 2 * k + 2]
        a, s = integer(1 << 40), int(rng.integers(0, 13))
        assert value_of(rounded, a=a, s=s) == called("RSHIFT_ROUND", a, s)
        bias, e = float(np.float32(rng.normal() * 100)), int(rng.integers(0, 21))
        assert value_of(scaled, x=bias, e=e) == called("ROUND_SCALED", f32_bits(bias), e)
        mean, i = integer(1 << 25), integer(1 << int(rng.integers(7, 26)))
        k = next((k for k in range(CONSTANTS["RAW_MAX"]) if i - 8 * k < CONSTANTS["SCALE_END"]), CONSTANTS["RAW_MAX"])
        place = [value_of(f, h=value_of(centred, mean=mean, k=k)) for f in found_at]
        assert (value_of(row, i=i, k=k), place[1], place[0], k) == called("SELECT", mean, i)
        a = {"origin": [integer(1 << 62)] * 3, "scale_mantissa": int(rng.integers(1, 65536))}
        a |= {"scale_exponent": int(rng.integers(-60, 61))}
        names = {"origin": a["origin"][0], "S": a["scale_mantissa"], "P": p[0], "E": a["scale_exponent"]}
        assert value_of(formulas("9.1")[0], **names) == called("WORLD", a, 0, p[0])
        base = abs(float(np.float32(rng.normal()) * np.float32(2.0) ** int(rng.integers(-40, 40))))
        mantissa, e = called("SIGNIFICAND", f32_bits(base))
        y, q = integer(1 << 23), int(rng.integers(0, 64))
        step = called("STEP_VALUE", q, f32_bits(base))
        names = {"step_table": spec["STEP"][q], "m": mantissa, "e": e}
        assert step == value_of(formulas("9.2")[0], **names)
        # Both are rounded once, so each is within half a unit in the last place of what it stands for.
        exact = value_of(formulas("7.8")[0], base_step=Fraction(base), step_table=spec["STEP"][q])
        assert abs(Fraction(f32_of(step)) - exact) <= exact / (1 << 24)
        unrounded = y * Fraction(f32_of(step))
        result = called("VALUE", y, step)
        assert abs(Fraction(f32_of(result)) - unrounded) <= abs(unrounded) / (1 << 24)
        # A binary32 multiplication gives it.
        assert result == f32_bits(float(np.float32(y) * np.float32(f32_of(step))))
    # The fewest chunks, and the least bytes of one.
    (fewest,) = formulas("6.2")
    for n, size in [(0, 3), (1, 3), (6, 3), (7, 3), (4096, 65536)]:
        assert value_of(fewest, N=n, chunk_size=size) == len(chunk_ranges(n, size))
    least, most_kept = formulas("6.10")
    assert [value_of(least, anchor_count=n) for n in (1, 16, 17, 16384)] == [17, 17, 18, 1040]
    assert value_of(most_kept, K=3, anchor_count=7) == 21
    weights, table = formulas("6.6")
    model_bytes = syntax.size_of("PositionModel")
    assert value_of(table, K=0, C=0, m=1) == model_bytes
    for d in (TINY_DIMENSIONS, MAIN_DIMENSIONS, PLANELESS, UNENCODED, CONSTANT):
        lengths = directory.section_lengths(d, 7, {directory.WEIGHTS: 0, directory.INDEX: 1})
        assert lengths[directory.WEIGHTS] == value_of(weights, carm_inputs=d.carm_inputs, W=weight_count(d))
        assert lengths[directory.INDEX] == value_of(table, K=d.offset_count, C=7, m=1)
        counts = Counter()
        for name, shapes in d.network_shapes().items():
            counts[name[:4]] += sum(out * (fan_in + 1) for out, fan_in in shapes)
        names = {"N": 1000, "W_a": counts["hype"] + counts["carm"], "W_s": counts["sarm"], "D": d.attribute_width}
        result = value_of(formulas("11.2")[0], ch=d.plane_channels, B=d.plane_size, **names)
        assert result == work(d, 1000) == called("WORK", header_of(spec, d, 1000))
    index, masked = formulas("7.6")
    order = [value_of(index, k=k, n=n) for k in range(10) for n in range(k + 1)]
    assert order == list(range(55))
    for d in (TINY_DIMENSIONS, MAIN_DIMENSIONS):
        assert value_of(formulas("6.3")[0], F=d.features, K=d.offset_count) == d.attribute_width
    assert value_of(masked, f=5) == (1 << 14) - 5
    assert value_of(symbol, centre=7, d=-2, k=4, raw=9) == 89
    escaped, rest = formulas("8.7")
    assert value_of(escaped, d=-11, R=5) == 6
    assert value_of(rest, n=11, z=3) == 3
    assert spec["DERIVE_ROW"]([0, 1 << 31], 0)[2] == CONSTANTS["EXPONENT_MAX"]
    # A state, before and after a word.
    slot, state = formulas("8.2")
    (refilled,) = formulas("8.3")
    for frequencies in ([1, 16382, 1], [5000, 0, 3, 11381], [16384]):
        for x in rng.integers(1 << 16, 1 << 18, 50).tolist():
            at = value_of(slot, x=x)
            j = next(j for j in range(len(frequencies)) if at < sum(frequencies[: j + 1]))
            right = value_of(state, x=x, frequency=frequencies[j], slot=at, low=sum(frequencies[:j]))
            stream = {"state": [x], "words": [54321], "word_at": 0}
            assert called("DECODE_SYMBOL", stream, 0, frequencies) == j
            assert stream["state"] == [right if right >= 1 << 16 else value_of(refilled, x=right, w=54321)]
    for n in range(40):
        (raw_bytes,) = formulas("8.8")
        ended = {"words": [], "word_at": 0, "state": [], "bad_escape": False, "bad_range": False, "raw_at": n}
        ended |= {"raw": [0] * value_of(raw_bytes, n=n), "symbols": [], "symbol_crc": 0}
        assert called("END", ended) is None
    # Cells, and trees of one cell, whose models give one symbol each.
    coordinate, child, first, second = formulas("7.12")
    for c, shift in product(rng.integers(0, 1 << 16, 20).tolist(), range(CONSTANTS["CELL_INDEX"])):
        if (bits := called("CELL_NUMBER", c, shift)) is not None:
            assert called("POSITION_INTEGER", bits) == value_of(coordinate, c=c, cell_shift=shift)
    corners = list(product(range(2), repeat=3))
    for chosen in product(corners, repeat=3):
        models = [[0] * 15 + [1 << 14]] * CONSTANTS["POSITION_MODELS"]
        for t, (x, y, z) in enumerate(chosen):
            halves = divmod(1 << value_of(child, x=x, y=y, z=z), 16)[::-1]
            for at, half in zip(
                (value_of(first, t=t), value_of(second, t=t, n=int(halves[0] > 0))), halves, strict=True
            ):
                models[at] = [(1 << 14) * (half == i) for i in range(16)]
        cells = called("DECODE_CELLS", {"state": [1 << 16], "symbols": []}, models, 1)
        levels = [min(level, 2) for level in range(CONSTANTS["CELL_LEVELS"])]
        right = [sum(chosen[t][axis] << level for level, t in enumerate(levels)) for axis in range(3)]
        assert cells == ([tuple(right)], True)
    for clause in HEADINGS:
        if clause[0] in "789":
            assert set(formulas(clause)) <= evaluated, f"{clause} has a formula that no test evaluates"


def f32_bits(x: float) -> int:
    """The 32 bits of a binary32 number."""
    return int.from_bytes(struct.pack("<f", x), "little")


def f32_of(bits: int) -> float:
    return float(struct.unpack("<f", bits.to_bytes(4, "little"))[0])


def header_of(spec: dict, d: Dimensions, anchors: int) -> dict[str, list[int]]:
    """The fields of a header as SPEC.md's blocks have them."""
    made = replace(random_scene(0, 2, d), chunk_size=1 << 14)
    data = list(codec.emit(made))
    value = spec["PARSE_HEADER"](data, *spec["PARSE_PROLOGUE"](data))["value"]
    return {**value, "anchor_count": [anchors]}


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
                frequencies = np.diff(model_bounds(models, model)).tolist()
                right = [
                    frequency(
                        p=lambda d, g=distribution, b=b, m=m: share(G=lambda y: g(x=y, b=b), d=d, m=m), d=mpmath.mpf(d)
                    )
                    for d in range(-radius, radius + 1)
                ]
                largest = right.index(max(right))
                right[largest] += (1 << 14) - 1 - sum(right)
                assert frequencies == [*right, 1], (i, f)


def model_bounds(models: tables.ModelSet, model: int) -> np.ndarray:
    """The slots at which the symbols of a model begin, and 2^14."""
    start, count = int(models.offset[model]), 2 * int(models.radius[model]) + 2
    return np.append(models.lower[start : start + count], 1 << 14).astype(np.int64)


def test_ancillary_types() -> None:
    """The letters are as 12.1 has them, and the type's clause of chapter 5 names the section."""
    for kind, entry in ancillary.TYPES.items():
        first, second, third, fourth = kind.decode("ascii")
        assert first.islower(), kind
        assert second.isupper(), kind
        assert third.isupper(), kind
        assert fourth.islower() == ancillary.is_safe_to_copy(kind), kind
        clause = specification.own_clauses()[entry.tables[entry.head]]
        assert clause.text.startswith(f"Section `{kind.decode()}`, mode 0:"), kind


def test_container_numbers() -> None:
    assert hashlib.sha256(tables.tables_file().read_bytes()).hexdigest() in TEXT
    assert SIGNATURE.hex(" ").upper() in section("5.1")
    sizes = {"Frame": 88, "ChunkEntry": ENTRY_BYTES, "Prologue": 20, "DirectoryEntry": 20}
    assert {name: syntax.size_of(name) for name in sizes} == sizes
    stated = re.findall(r"^Section `(\w{4})`", section_of("5"), re.MULTILINE)
    assert [name.encode() for name in stated[:5]] == list(directory.SECTIONS)
    for kind in directory.SECTIONS:
        assert re.search(rf"\| {kind.decode()} ", section("1.1")), kind


def section_of(chapter: str) -> str:
    """The text of a whole chapter."""
    return re.search(rf"^## {chapter} .*?(?=^## )", TEXT, re.DOTALL | re.MULTILINE)[0]


def test_profiles_and_levels(spec: dict) -> None:
    """The tables of chapter 11, as SPEC.md's blocks use them, against the code's."""
    for number, profile in PROFILES.items():
        for name, low, high in spec["BOUNDS"][number]:
            assert (low, high) == getattr(profile, name), name
        levels = {level["level"]: level for level in spec["LEVELS"] if level["profile"] == number}
        assert {n: (x["anchor_count"], x["plane_size"], x["work"]) for n, x in levels.items()} == {
            n: (x.anchors, x.plane_size, x.work) for n, x in profile.levels.items()
        }
    printed = {name: cells for name, *cells in rows(section("11.1"))}
    optional = {name for name, cells in printed.items() if all(cell.startswith("0, or ") for cell in cells)}
    assert optional == {"plane_size", "sarm_layers"}


def test_networks_table() -> None:
    d = TINY_DIMENSIONS
    space = {"ch": d.plane_channels, "L": d.frequency_count, "F": d.features, "K": d.offset_count}
    space |= {**vars(d), "render_width": (d.render_width,), "D": d.attribute_width}
    shapes = d.network_shapes()
    printed = [r for r in rows(section("5.8")) if len(r) == 5]
    assert [r[0].replace(".i", ".1") for r in printed] == list(shapes)
    for name, inputs, hidden, outputs, _ in printed:
        if name.startswith("carm"):
            assert (inputs, outputs) == ("sum of the widths of slices 0 to i - 1", "2 slice_width[i]")
            fan_in, out = d.slices[0], 2 * d.slices[1]
        else:
            fan_in, out = (eval(re.sub(r"(\d) (?=[A-Za-z])", r"\1*", text), space) for text in (inputs, outputs))
        widths = [fan_in, *space[hidden], out]
        assert shapes[name.replace(".i", ".1")] == list(zip(widths[1:], widths[:-1], strict=True))


def agree(spec: dict, data: bytes) -> None:
    """Asserts that SPEC.md's blocks and the code give a file the same digests: the scene's, its parts', its chunks'.

    tests/conformance/test_decoders.py compares their verdicts on any file.
    """
    digests, error = spec_decoder.verdict(spec, data)
    assert error is None
    scene = codec.parse(data).scene
    whole, parts = reconstruction.digest(scene)
    assert bytes(digests["scene"]).hex() == whole
    assert [bytes(part).hex() for part in digests["parts"]] == list(parts.values())
    chunks = [reconstruction.chunk_digest(take_anchors(scene, np.array(anchors))) for anchors in scene.chunks]
    assert [bytes(chunk).hex() for chunk in digests["chunks"]] == chunks


# What 2.4 lists, as the syntax of Python names it.
NOTATION = (
    ast.Module, ast.FunctionDef, ast.arguments, ast.arg, ast.Return, ast.Assign, ast.AugAssign, ast.For, ast.While,
    ast.If, ast.Expr, ast.Call, ast.Name, ast.Load, ast.Store, ast.Constant, ast.BinOp, ast.UnaryOp, ast.BoolOp,
    ast.Compare, ast.IfExp, ast.List, ast.Tuple, ast.Dict, ast.Subscript, ast.Slice, ast.ListComp, ast.comprehension,
    ast.Add, ast.Sub, ast.Mult, ast.FloorDiv, ast.Mod, ast.LShift, ast.RShift, ast.BitAnd, ast.BitOr, ast.BitXor,
    ast.USub, ast.Not, ast.And, ast.Or, ast.Eq, ast.NotEq, ast.Lt, ast.LtE, ast.Gt, ast.GtE, ast.Is, ast.IsNot, ast.In,
    ast.NotIn,
)  # fmt: skip
FUNCTIONS = {"abs", "all", "any", "enumerate", "len", "max", "min", "range", "sum", "zip"}


def test_the_notation_of_the_blocks() -> None:
    """The blocks of the exact chapters keep to the notation of 2.4: no language's own types or functions are needed.

    The block that says in Python what REFUSE does is the only one with a class.
    """
    exact = re.sub(r"^## 14 .*?(?=^## Annex A)", "", TEXT, flags=re.DOTALL | re.MULTILINE)
    printed = re.findall(r"^```python\n(.*?)^```", exact, re.DOTALL | re.MULTILINE)
    defined = set(re.findall(r"^(?:def )?([A-Z_0-9]+)(?:\(| =)", "\n".join(printed), re.MULTILINE))
    stated = section("2.4")
    for name in FUNCTIONS:
        assert f"`{name}" in stated, f"{name} is not in 2.4"
    for block in printed:
        if "class Refused" in block:
            continue
        tree = ast.parse(block)
        for node in ast.walk(tree):
            append = isinstance(node, ast.Attribute) and node.attr == "append"
            assert append or isinstance(node, NOTATION), f"not in 2.4: {type(node).__name__}, {ast.unparse(node)[:80]}"
            if isinstance(node, ast.Call) and not isinstance(node.func, ast.Attribute):
                called = node.func
                assert isinstance(called, ast.Name), ast.unparse(node)
                local = {n.name for n in ast.walk(tree) if isinstance(n, ast.FunctionDef)}
                known = FUNCTIONS | defined | local | {"SHA256", "ASCII"}
                assert called.id in known, f"{called.id} is not in 2.4"
                assert called.id not in dir(builtins) or called.id in FUNCTIONS
            if isinstance(node, ast.Constant):
                assert isinstance(node.value, int | str | None), ast.unparse(node)
            if isinstance(node, ast.AugAssign):
                assert isinstance(node.op, ast.Add | ast.Sub | ast.BitOr), ast.unparse(node)
            if isinstance(node, ast.Slice):
                assert node.step is None, ast.unparse(node)
                # A slice that ends before the last item is the only one that counts from the end.
                ends = [end for end in (node.lower, node.upper) if isinstance(end, ast.UnaryOp)]
                assert all(ast.unparse(end) == "-1" and end is node.upper for end in ends), ast.unparse(node)


def test_the_order_of_operators() -> None:
    """The table of 2.4 is the order of Python, in which the blocks are executed."""
    order = [re.findall(r"`([^`]+)`", row[0].replace(r"\|", "|")) for row in rows(section("2.4"))]
    assert order[0] == ["f(x)", "x[i]"]
    assert (order[1], order[-1]) == (["-"], ["a if c else b"])
    ranks = [[o for o in row if o != "not"] for row in order[2:-1]]
    assert sum(map(len, ranks)) == 22
    tight: list[str] = []
    for rank in ranks:
        for loose in rank:
            # The looser operator is the outer one, wherever it stands.
            for inner in tight:
                for text in (f"a {inner} b {loose} c", f"c {loose} a {inner} b"):
                    bound = text.replace(f"a {inner} b", f"(a {inner} b)")
                    assert ast.dump(ast.parse(text)) == ast.dump(ast.parse(bound)), text
        # and and or give the same from either side.
        if not set(rank) & {"==", "and", "or"}:
            for one, two in product(rank, rank):
                assert ast.dump(ast.parse(f"a {one} b {two} c")) == ast.dump(ast.parse(f"(a {one} b) {two} c")), rank
        tight += rank
    assert ast.dump(ast.parse("not a == b and c")) == ast.dump(ast.parse("(not (a == b)) and c"))
    assert ast.dump(ast.parse("-a * b")) == ast.dump(ast.parse("(-a) * b"))


def test_normative_text_names_no_file_of_the_repository() -> None:
    """Pictures are informative, and the annexes behind A are, too."""
    body = re.sub(r"!\[[^\]]*\]\([^)]*\)", "", PROSE.partition("## Annex B")[0])
    assert not re.findall(r"(?:refcodec|conformance|vectors|spec|benchmarks|tests)/\w+|python -m|refcodec \w+", body)


def test_worked_example(spec: dict) -> None:
    data = EXAMPLE.read_bytes()
    assert len(data) <= 4096
    agree(spec, data)
    assert codec.emit(codec.parse(data).scene) == data
    printed = {of: digest.strip("`") for of, digest in rows(section("D.2"))}
    digests, _ = spec_decoder.verdict(spec, data)
    assert printed["the scene"] == bytes(digests["scene"]).hex()
    assert [printed[f"chunk {n}"] for n in range(len(digests["chunks"]))] == [bytes(c).hex() for c in digests["chunks"]]


def test_the_walk_is_the_file() -> None:
    """Annex D and its page against the vector, without the code that printed them.

    The structs of D.1 lie side by side from the first byte to the last. So do the elements, with their values, and the
    raw bits.
    """
    data = EXAMPLE.read_bytes()
    end = left_out = 0
    for start, printed, elements in rows(section("D.1")):
        assert int(start, 16) == end, start
        shown, _, more = re.sub(r"00\*(\d+)", lambda zeros: "00 " * int(zeros[1]), printed.strip("`")).partition("+")
        part = bytes.fromhex(shown)
        assert part == data[end : end + len(part)], start
        assert elements
        left_out += int(more or 0)
        end += len(part) + int(more or 0)
    assert end == len(data)
    assert left_out < len(data) * 2 // 3
    end = 0
    for start, length, contents, element, value, meaning in rows(generated("elements")):
        assert int(start, 16) == end, start
        end += int(length)
        shown = bytes.fromhex(contents.strip("`").removesuffix(" ..."))
        assert data[int(start, 16) : end].startswith(shown)
        assert len(shown) == min(int(length), 8)
        assert meaning
        if re.fullmatch(r"-?\d+", value) and "low" not in element and "high" not in element:
            assert int.from_bytes(shown, "little", signed=value.startswith("-")) == int(value), element
    assert end == len(data)
    bits = rows(generated("raw"))
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
    ends = {element: int(start, 16) + int(length) for start, length, _, element, *_ in rows(generated("elements"))}
    assert last == 8 * ends["attributes[chunk 1].raw"]
    states = rows(generated("steps"))
    assert all(states[i][4] == states[i - 1][9] for i in range(1, len(states)))
    # The first state stands behind the head of sub-plane 0.
    (at,) = (int(start, 16) for start, _, _, name, *_ in rows(generated("elements")) if name == "planes.r1.state")
    assert int(states[0][4], 16) == int.from_bytes(data[at : at + 4], "little")


def coded(table: list[list[str]], state: int) -> Iterator[tuple[list[str], int]]:
    """Yields each row of a table of coder steps with the model index, after a check of 8.2. state: its column."""
    for row in table:
        before, slot, slots, word, after = row[state : state + 5]
        index, low, last = (int(n) for n in re.fullmatch(r"(\d+): (\d+) to (\d+)", slots).groups())
        x = int(before, 16)
        assert low <= int(slot) == x & 0x3FFF <= last
        x = (last - low + 1) * (x >> 14) + x % 2**14 - low
        assert (x < 2**16) == bool(word)
        assert int(after, 16) == (x << 16 | int(word, 16) if word else x)
        yield row, index


def test_packed_positions_and_weights_as_printed(spec: dict) -> None:
    """D.3 and D.4 give the positions and the layer of the second file, without the code that printed them."""
    data = EXAMPLE.with_name("tiny-packed.c3gs").read_bytes()
    agree(spec, data)
    scene = codec.parse(data).scene
    assert codec.emit(scene) == data
    for number in ("D.3", "D.4"):
        for line in re.search(r"^```text\n(.*?)\n```", section(number), re.DOTALL | re.MULTILINE)[1].splitlines():
            assert bytes.fromhex(re.sub(r"^[A-Za-z]+ +", "", line)) in data
    printed = rows(section("D.3"))
    models = {int(r[0]): [int(f) for f in r[1].split(", ")] for r in printed if len(r) == 2}
    assert all(scene.position_model.frequency[n].tolist() == frequency for n, frequency in models.items())
    cells: dict[tuple[int, str], list[int]] = {}
    for row, index in coded([r for r in printed if len(r) == 9], 3):
        assert [int(n) % 4 for n in row[8].split(", ") if n] == [i for i in range(4) if index >> i & 1]
        cells.setdefault((int(row[0]), row[1]), []).append(index)
        assert sum(models[int(row[2])][:index]) == int(row[5].split()[1])
    nodes = [(0, 0, 0)]
    for level in range(15, -1, -1):
        halves = [cells[level, str(node)] for node in nodes]
        nodes = [
            (2 * x + (k & 1), 2 * y + (k >> 1 & 1), 2 * z + (k >> 2))
            for (x, y, z), (low, high) in zip(nodes, halves, strict=True)
            for k in range(8)
            if (low | high << 4) >> k & 1
        ]
    assert [[c - 2**15 for c in node] for node in nodes] == scene.positions.tolist()
    printed, model = rows(section("D.4")), re.search(r"^LayerModel +(.*)$", section("D.4"), re.MULTILINE)[1]
    symbols = [int(row[-1]) for row, _ in coded([r for r in printed if len(r) == 10], 4)]
    exponents = list(accumulate(symbols[:3], initial=int.from_bytes(bytes.fromhex(model)[2:4], "little")))[1:]
    pairs = zip(symbols[6::2], symbols[7::2], strict=True)
    values = [[n * 2.0**-e for n in row] for e, row in zip(exponents, pairs, strict=True)]
    biases = [n * 2.0**-e for e, n in zip(exponents, symbols[3:6], strict=True)]
    weight, bias = scene.networks["colour"][1]
    assert (values, biases) == (weight.tolist(), bias.tolist())
    assert [(r[1], r[2]) for r in printed if len(r) == 3] == [
        (", ".join(map(str, row)), str(b)) for row, b in zip(values, biases, strict=True)
    ]


@pytest.mark.parametrize("name", ["tiny-example", "tiny-packed"])
def test_a_scene_as_text_gives_the_file(name: str) -> None:
    """Annex D: the numbers of the JSON document, and nothing else, make the file."""
    path = EXAMPLE.with_name(f"{name}.json")
    doc = json.loads(path.read_text(encoding="utf-8"))

    def of(kind: type, value: dict[str, Any]) -> Any:
        return kind(**{k: tuple(v) if isinstance(v, list) else v for k, v in value.items()})

    d, count = of(Dimensions, doc["dimensions"]), len(doc["anchors"])

    def anchors(key: str, dtype: type, *shape: int) -> np.ndarray:
        return np.array([anchor[key] for anchor in doc["anchors"]], dtype).reshape(count, *shape)

    arrays = {"carm_shift": np.uint8, "mask_model": np.uint16, "weight_scales": np.uint8, "weight_forms": np.uint8}
    given: dict[str, Any] = {name: doc[name] for name in ("profile", "chunk_size", "plane_shift")}
    given |= {name: doc[name] and tuple(doc[name]) for name in ("base_step", "chunk_anchors", "position_forms")}
    given |= {name: None if doc[name] is None else np.array(doc[name], dtype) for name, dtype in arrays.items()}
    scene = Scene(
        dimensions=d,
        **given,
        lanes=of(Lanes, doc["lanes_log2"]),
        grid=of(PositionGrid, doc["position_grid"]),
        render=of(RenderInfo, doc["render_info"]),
        frame=doc["frame"] and Frame(**{k: np.array(v, np.int64) for k, v in doc["frame"].items()}),
        networks={
            network: [
                (np.array(layer["weight"], np.float32).reshape(shape), np.array(layer["bias"], np.float32))
                for layer, shape in zip(layers, d.network_shapes()[network], strict=True)
            ]
            for network, layers in doc["networks"].items()
        },
        planes=np.array(doc["planes"], np.int16).reshape(5, d.plane_channels, d.plane_size, d.plane_size),
        positions=anchors("position", np.float16, 3),
        masks=anchors("mask", np.bool_, d.offset_count),
        attributes=Attributes(
            anchors("features", np.int32, d.features),
            anchors("scalings", np.int32, 6),
            anchors("offsets", np.int32, d.offset_count, 3),
            anchors("step_index", np.uint8, 3),
        ),
        ancillary=tuple(
            Ancillary(s["type"].encode(), s["mode"], bytes.fromhex(s["content"]), s["after"]) for s in doc["ancillary"]
        ),
        position_model=doc["position_model"]
        and PositionModel(doc["cell_shift"], np.array(doc["position_model"], np.uint16)),
    )
    assert codec.emit(scene) == path.with_suffix(".c3gs").read_bytes()


@pytest.mark.parametrize(
    ("path", "right", "wrong", "fault"),
    [
        ("refcodec/folder/read.py", "(SPEC 5.15)", "(SPEC 5.16)", "5.16 is not about this code"),
        ("refcodec/bitstream/reader.py", "10.1, CHUNKS: y", "10.1, SECTIONS: y", "SECTIONS is not about this"),
        ("refcodec/bitstream/planes.py", "10.1, SECTIONS", "10.1, step 5", "step 5: the steps of 10.1 have names"),
        ("refcodec/bitstream/frame.py", "[R6.7-2]", "[R6.7-9]", "R6.7-9 is not a requirement"),
        ("refcodec/web/container.js", "// 6.1\n", "// 6.91\n", "6.91 is not a clause"),
    ],
)
def test_a_wrong_citation_is_reported(path: str, right: str, wrong: str, fault: str) -> None:
    source = (ROOT / path).read_text(encoding="utf-8")
    assert right in source
    assert not list(citations.faults(path, source))
    assert fault in "\n".join(citations.faults(path, source.replace(right, wrong)))


def test_a_file_that_has_no_text(tmp_path: Path) -> None:
    """`python -m spec.example` names the error of a file, and of a place without one."""
    cut = tmp_path / "cut.c3gs"
    cut.write_bytes((ROOT / "vectors" / "tiny-example.c3gs").read_bytes()[:300])
    for place, reason in ((cut, "R6.6-6"), (tmp_path / "none", "No such file")):
        command = [sys.executable, "-m", "spec.example", str(place)]
        ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        assert ended.returncode == 1
        assert ended.stderr.count("\n") == 1
        assert reason in ended.stderr
