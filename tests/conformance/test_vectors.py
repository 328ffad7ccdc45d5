"""The suite's vectors: the manifest is right, the generator reproduces the bytes, and every decoder here agrees."""

import hashlib
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from numpy.typing import NDArray

from conformance import cli, spec_decoder
from conformance import manifest as manifests
from conformance.cases import attributes, recipes
from conformance.cases.cameras import expected
from conformance.cases.fault import Refused
from conformance.cases.features import FEATURES
from conformance.cases.flags import FLAGS
from conformance.cases.numbers import Numbers
from conformance.cases.suite import GeneratorError, archived, vectors
from conformance.cases.table import Recipe, valid
from conformance.manifest import ARCHIVE, MANIFEST, VECTORS, GaussiansOf, ImageOf, ManifestError, Rejected, Vector, load
from conformance.runner.gaussians import difference
from conformance.runner.grading import read_output
from conformance.runner.images import image_difference
from refcodec.bitstream import codec
from refcodec.bitstream.entropy import select
from refcodec.bitstream.errors import REGISTRY
from refcodec.bitstream.header import MAJOR
from refcodec.bitstream.reconstruction import PARTS, SPLAT
from refcodec.bitstream.tables import tables
from refcodec.cli.main import main
from refcodec.inspect import specification
from refcodec.rendering.view import pfm
from refcodec.statuses import UsageError
from spec.coverage import probed
from spec.matrix import NO_VECTOR

SUITE = load()
DECODED = [v for v in SUITE.vectors if v.operation == "decode"]
SEEN = [v for v in SUITE.vectors if isinstance(v.expectation, GaussiansOf)]
IMAGES = [v for v in SUITE.vectors if isinstance(v.expectation, ImageOf)]
# What takes plain Python long is left to test_whole_suite.
QUICK = [v for v in DECODED if v.budget.seconds <= 10]
# SPEC.md's blocks take a second for some thousands of symbols.
SMALL = [v for v in DECODED if v.klass != "resource" and v.input.size < (7000 if v.klass == "valid" else 40000)]


def data(vector: Vector) -> bytes:
    return SUITE.path(vector).read_bytes()


def sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


# --- the manifest -----------------------------------------------------------------------------------------------------


def document() -> dict[str, Any]:
    manifest: dict[str, Any] = json.loads((VECTORS / MANIFEST).read_text(encoding="utf-8"))
    return manifest


def test_files_are_those_of_the_manifest() -> None:
    listed = {v.input.path for v in SUITE.vectors} | {
        v.expectation.path for v in [*SEEN, *IMAGES] if isinstance(v.expectation, GaussiansOf | ImageOf)
    }
    there = {str(p.relative_to(VECTORS)) for p in VECTORS.glob("*/*")}
    assert listed == {name for name in there if not name.startswith(f"{ARCHIVE}/")}
    for vector in SUITE.vectors:
        assert (vector.input.size, vector.input.sha256) == (len(data(vector)), sha256(data(vector)))
    assert sum(p.stat().st_size for p in VECTORS.rglob("*")) < 7_000_000


def test_everything_has_a_vector() -> None:
    """Every requirement that a file can test, every error, feature and flag."""
    assert {v.expectation.name for v in DECODED if isinstance(v.expectation, Rejected)} == set(REGISTRY)
    proved = {name for v in SUITE.vectors for name in v.requirements}
    names = set(specification.requirements(specification.text()))
    assert names - proved == set(NO_VECTOR)
    assert proved <= names
    assert {f for v in SUITE.vectors for f in v.features} == set(FEATURES)
    assert {f for v in SUITE.vectors for f in v.flags} == set(FLAGS)
    assert (len(SEEN), len(IMAGES)) == (8, 15)


def test_errors_are_those_of_the_registry() -> None:
    for vector in DECODED:
        e = vector.expectation
        if isinstance(e, Rejected):
            kind = REGISTRY[e.name]
            assert (e.code, e.clause) == (kind.code, kind.clause)
            assert vector.klass in (kind.klass, "resource")


@pytest.mark.parametrize("member", ["", "vector", "input", "expectation", "expectation parts", "budget", "generator"])
def test_the_schema_and_the_program_allow_no_other_field(member: str) -> None:
    """member: of the manifest (""), or of its first vector."""
    schema = json.loads((VECTORS / manifests.SCHEMA).read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator.check_schema(schema)
    whole = document()
    smaller = {**whole, "vectors": whole["vectors"][:1]}
    jsonschema.validate(smaller, schema)
    at: Any = smaller["vectors"][0] if member else smaller
    for step in member.removeprefix("vector").split():
        at = at[step]
    for change in (lambda: at.update(more=1), at.popitem, at.popitem):
        change()
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(smaller, schema)
        with pytest.raises(ManifestError):
            manifests.parse(smaller, VECTORS)
        at.pop("more", None)


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (lambda d: d["vectors"].append(d["vectors"][0]), "two vectors have the id"),
        (lambda d: d["vectors"][0]["flags"].append("unheard-of"), "not defined in flags"),
        (lambda d: d["features"].update({"nobody-has": "this"}), "no vector has nobody-has"),
        (lambda d: d["vectors"][0].update({"class": "malformed"}), "with another result"),
        (lambda d: d["vectors"][0].update({"operation": "gaussians"}), "operation gaussians"),
        (lambda d: d["vectors"][0]["features"].append(d["vectors"][0]["features"][0]), "a name is repeated"),
        (lambda d: d["vectors"][0]["expectation"]["parts"].popitem(), "its parts are"),
    ],
)
def test_what_a_schema_cannot_say(change: Callable[[dict[str, Any]], None], what: str) -> None:
    changed = document()
    assert manifests.parse(changed, VECTORS) == SUITE
    change(changed)
    with pytest.raises(ManifestError, match=what):
        manifests.parse(changed, VECTORS)


def test_manifests_that_are_none(tmp_path: Path) -> None:
    whole = (VECTORS / MANIFEST).read_text(encoding="utf-8")
    for content, what in (
        ("{", "Expecting"),
        (json.dumps({**document(), "vectors": []}), "length >= 1"),
        (whole.replace("{", '{"suite": 1,', 1), "twice"),
        (whole.replace(f'"format_version": {MAJOR}', '"format_version": 9'), "enum value 9"),
        (json.dumps({**document(), "vectors": document()["vectors"][:1]}), "no vector has"),
    ):
        (tmp_path / MANIFEST).write_text(content, encoding="utf-8")
        with pytest.raises(ManifestError, match=what):
            load(tmp_path / MANIFEST)
    with pytest.raises(OSError, match="No such file"):
        load(tmp_path / "none" / MANIFEST)


def test_the_archive() -> None:
    """It has a line for each file of the suite, with its verdict, in order. A line neither changes nor leaves."""
    text = (VECTORS / ARCHIVE / f"{MAJOR}.tsv").read_text(encoding="utf-8")
    lines, decoded = text.splitlines()[1:], [v for v in document()["vectors"] if v["operation"] == "decode"]
    assert lines == sorted(set(lines))
    assert archived(text, decoded) == text
    # Of a suite without the first vector its line stays; another file of it gets a line of its own.
    first = decoded[0]
    assert archived(text, decoded[1:]) == text
    other = {**first, "input": {**first["input"], "sha256": "0" * 64}}
    assert set(archived(text, [other]).splitlines()) > set(text.splitlines())
    with pytest.raises(UsageError, match="its line in archive differs"):
        archived(text, [{**first, "expectation": {**first["expectation"], "digest": "0" * 64}}])


# --- the generator ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_suite_is_the_same_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """And refcodec gives what the manifest expects, since that is where it comes from."""
    assert cli.main(["generate", "-o", str(tmp_path / "suite")]) == 0
    assert f"{len(SUITE.vectors)} vectors" in capsys.readouterr().out
    made = {
        str(p.relative_to(tmp_path / "suite")): p.read_bytes() for p in (tmp_path / "suite").rglob("*") if p.is_file()
    }
    kept = {str(p.relative_to(VECTORS)): p.read_bytes() for p in VECTORS.rglob("*") if p.is_file()}
    kept = {name: data for name, data in kept.items() if name != "README.md" and not name.startswith("tiny-")}
    assert made.keys() == kept.keys()
    assert [name for name in made if made[name] != kept[name]] == []
    assert load(tmp_path / "suite" / MANIFEST).vectors == SUITE.vectors


def test_numbers_are_the_same_on_every_machine() -> None:
    """The definition: eight bytes of SHAKE-256 of name, seed and draw, modulo the span."""
    numbers = Numbers("a name", 7)
    for draw in range(3):
        stream = hashlib.shake_256(f"a name/7/{draw}".encode()).digest(40)
        expected = [int.from_bytes(stream[8 * i : 8 * i + 8], "little") % 11 - 5 for i in range(5)]
        assert numbers.integers(-5, 5, 5).tolist() == expected
    assert Numbers("a name").integer(3, 3) == 3


def test_recipes_that_say_something_else() -> None:
    """The generator believes no recipe."""
    plain = next(r for r in recipes() if r.id == "valid-worked-example")
    made = plain.make()
    for klass, result, what in (
        ("malformed", Refused(made[:19], "prologue.truncated", 18), "refcodec prologue.truncated at 19"),
        ("malformed", Refused(made, "prologue.truncated", 19), "accepts the file"),
        ("invalid", Refused(made[:19], "prologue.truncated", 19), "is malformed"),
    ):
        with pytest.raises(GeneratorError, match=what):
            list(vectors([Recipe(f"{klass}-wrong", "a wrong recipe", lambda result=result: result, ("header",))]))  # type: ignore[misc]


def test_an_identifier_is_permanent(monkeypatch: pytest.MonkeyPatch) -> None:
    """Recipes are in the manifest's order. A new case comes last wherever its file is; one that is gone is told."""
    new = valid("masks", "", "", ("new", "a new case", bytes))
    monkeypatch.setattr(attributes, "CASES", [*new, *attributes.CASES])
    assert [r.id for r in recipes()] == [*(v.id for v in SUITE.vectors), "valid-new"]
    monkeypatch.setattr(attributes, "CASES", [])
    with pytest.raises(
        ValueError, match=r"no case has the identifiers .*valid-mask-contexts, valid-mask-model-extreme, "
    ):
        recipes()


def test_the_generator_does_without_hypothesis() -> None:
    """The extra `test` is not needed for the suite."""
    without = "import sys; sys.modules['hypothesis'] = None"
    code = f"{without}; from conformance.cases import recipes; recipes()[-1].make()"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=VECTORS.parent)


# --- the decoders -----------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.no_cover
@pytest.mark.requirement("D15.4-1", "D9.3-1", "D10.2-1", "D10.2-3", "DH-1")
def test_the_second_decoder() -> None:
    """It gives the digests or the error of each vector. The vectors reach every statement, and both outcomes of every
    condition."""
    own = probed()
    for vector in SUITE.vectors:
        if isinstance(vector.expectation, GaussiansOf):
            e = vector.expectation
            assert sha256(expected(data(vector), e.camera, own.names)) == e.sha256, vector.id
    for vector in QUICK:
        result, error = spec_decoder.verdict(own.names, data(vector))
        e = vector.expectation
        if isinstance(e, Rejected):
            assert error == (e.name, e.offset), vector.id
            continue
        assert error is None, vector.id
        assert bytes(result["scene"]).hex() == e.digest, vector.id
        assert [bytes(part).hex() for part in result["parts"]] == [
            e.parts[name] for name in (*PARTS, SPLAT) if name in e.parts
        ], vector.id
    for vector in DECODED:
        if vector not in QUICK:
            # test_whole_suite decodes these. Here their headers alone reach the rules of levels.
            header = data(vector)[: 20 + int.from_bytes(data(vector)[12:16], "little")]
            assert spec_decoder.verdict(own.names, header)[1] == ("section.truncated", len(header)), vector.id
    assert [site for site, each in zip(own.sites, own.seen, strict=True) if not each and not site.argued()] == []


def test_what_is_tested_is_there() -> None:
    """Symbols of every row and column of both families, each end and the escape among them."""
    for name, family in (("valid-models-gauss", "gauss"), ("valid-models-laplace", "laplace")):
        rows: list[Any] = []
        vector = next(v for v in DECODED if v.id == name)
        codec.parse(data(vector), trace=rows.append)
        used = [row for row in rows if row.family == family]
        mean, scale, value = (np.array([getattr(row, kind) for row in used]) for kind in ("mean", "scale", "value"))
        model, centre, raw = select(mean, scale)
        radius = getattr(tables(), family).radius[model]
        distance = (value >> raw) - centre
        kinds = np.where(
            np.abs(distance) > radius, 0, np.where(distance == -radius, 1, np.where(distance == radius, 2, 3))
        )
        seen = set(zip(model.tolist(), kinds.tolist(), strict=True))
        assert len({m for m, _ in seen}) > 1000, name
        for kind in range(3):
            assert len([1 for _, k in seen if k == kind]) > 850, (name, kind)


# --- commands ---------------------------------------------------------------------------------------------------------


def test_gaussians_that_differ() -> None:
    g: dict[str, Any] = {"anchor": 3, "offset": 1, "mean": [1.0, 2.0, 3.0], "lengths": [0.5, 0.5, 0.5]}
    g |= {"quaternion": [1.0, 0.0, 0.0, 0.0], "opacity": 0.5, "colour": [0.1, 0.2, 0.3]}

    def listed(*gaussians: dict[str, Any]) -> str:
        return json.dumps({"gaussians": gaussians})

    faint = {**g, "anchor": 4, "opacity": 0.5e-4}
    assert difference(listed(g), listed(g), 1e-4) is None
    assert difference(listed(g), listed(faint, g), 1e-4) is None
    assert difference(listed(g, faint), listed(g), 1e-4) is None
    assert difference(listed(g), listed({**g, "quaternion": [-1.0, 0.0, 0.0, 0.0]}), 1e-4) is None
    for gaussians, what in (
        ([], "missing"),
        ([g, {**g, "anchor": 9}], "anchor 9, offset 1: there is none"),
        ([{**g, "mean": [1.0, 2.0, 3.001]}], "mean"),
        ([{**g, "mean": [1.0, 2.0, float("nan")]}], "a number is nan"),
        ([{**g, "mean": [1.0, 2.0, "nan"]}], "mean"),
        ([{**g, "colour": [0.1, 0.2]}], "another length"),
        ([g, g], "twice"),
        ([{**g, "opacity": 0.51}], "opacity"),
        ([{**g, "quaternion": [0.0, 1.0, 0.0, 0.0]}], "quaternion"),
        ([{**g, "mean": [-1.0, -2.0, -3.0]}], "mean"),
        ([{"anchor": 1}], "no list"),
    ):
        assert what in str(difference(listed(g), listed(*gaussians), 1e-4)), what
    # A mean is as exact as its distance from the anchor asks, and that of a static scene as binary32.
    near = {**g, "mean": [1.0, 2.0, 3.0009]}
    assert difference(listed({**g, "reach": 10.0}), listed(near), 1e-4) is None
    assert "the same numbers" in str(difference(listed({**g, "reach": 10.0}), listed(near), 1e-4, static=True))
    assert difference(listed({**g, "colour": [0, 0, 0]}), listed({**g, "colour": [1e-7, 0, 0]}), 1e-4) is None
    assert difference(listed(g), "[]", 1e-4)
    assert difference(listed(g), "not JSON", 1e-4)


@pytest.mark.requirement("G14.5-1")
def test_images_that_differ() -> None:
    right = np.random.default_rng(0).random((40, 50, 3)).astype(np.float32)

    def wrong(change: Callable[[NDArray[np.float32]], Any]) -> str:
        made = right.copy()
        change(made)
        return image_difference(pfm(right), pfm(made)) or ""

    def shift(pixels: int, error: float) -> str:
        return wrong(lambda made: made.reshape(-1, 3).__setitem__(slice(pixels), made.reshape(-1, 3)[:pixels] + error))

    # 2,000 pixels.
    assert shift(2, 0.06) == shift(2000, 0.0031) == ""
    assert "3 of 2000 pixels" in shift(3, 0.0158)
    assert "49." in shift(2000, 0.0034)
    assert "not finite" in wrong(lambda made: made.__setitem__((0, 0, 0), np.nan))
    assert "50 x 39 pixels, 50 x 40 expected" in image_difference(pfm(right), pfm(right[1:]))
    for output in (b"", b"PF\n50 40\n-1.0\n", pfm(right)[:-1], pfm(right) + b"\0", b"Pf" + pfm(right)[2:]):
        assert "PFM" in image_difference(pfm(right), output)
    big = pfm(right).replace(b"-1.0", b"1.0", 1)
    assert image_difference(pfm(right), big[:13] + right[::-1].astype(">f4").tobytes()) is None


def written_digest(output: Path) -> str:
    """The digest of the output of a decoder."""
    with output.open("rb") as file:
        return read_output(file).digest


def test_the_reconstruct_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    vector = next(v for v in DECODED if v.id == "valid-plain")
    e = vector.expectation
    output, trace = tmp_path / "out.bin", tmp_path / "trace.txt"
    for arguments in ([], ["--trace", str(trace)]):
        assert main(["reconstruct", str(SUITE.path(vector)), str(output), *arguments]) == 0
        assert written_digest(output) == e.digest
    assert sha256(trace.read_bytes()) == e.trace
    output.write_bytes(b"something else")
    assert main(["reconstruct", str(SUITE.path(vector)), str(output)]) == 64
    assert "is not a reconstruction" in capsys.readouterr().err
    bad = next(v for v in DECODED if v.id == "invalid-attributes-symbol-crc")
    assert main(["reconstruct", str(SUITE.path(bad)), str(tmp_path / "none.bin"), "--trace", str(trace)]) == 1
    assert json.loads(capsys.readouterr().err.splitlines()[-1])["code"] == 509
    assert not (tmp_path / "none.bin").exists()
    assert "attributes." in trace.read_text()
