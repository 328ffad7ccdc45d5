"""The coverage of SPEC.md's blocks by the vectors. tests/conformance/test_vectors.py proves that there is no hole."""

import contextlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from msgspec import structs

from conformance import spec_decoder
from conformance.manifest import Rejected, load
from conformance.spec_decoder.program import SPEC
from refcodec.inspect.elements import rows
from spec import coverage, elements, neighbours

SUITE = load()
EXAMPLE = next(vector for vector in SUITE.vectors if vector.id == "valid-worked-example")
DATA = (SUITE.folder / EXAMPLE.input.path).read_bytes()


def test_probes_change_nothing() -> None:
    probes = coverage.probed()
    for data in (DATA, DATA[:-1], b""):
        digests, error = spec_decoder.verdict(probes.names, data)
        own, wrong = spec_decoder.verdict(spec_decoder.names(), data)
        assert (digests, error) == (own, wrong)
    kinds = {coverage.LINE, coverage.TRUE, coverage.FALSE, coverage.AT, coverage.BEYOND}
    assert {site.kind for site in probes.sites} == kinds
    assert {site.function for site in probes.sites} >= coverage.IMAGES
    assert probes.extremes["accumulator of a row"][1] < 1 << 24


def test_each_quantity_has_its_bound() -> None:
    text = SPEC.read_text(encoding="utf-8")
    lines, unreached = coverage.extremes_of(text, dict.fromkeys(coverage.QUANTITIES.values(), (-3, 2)))
    assert unreached == len(coverage.QUANTITIES) - len(coverage.TOO_LARGE)
    assert coverage.extremes_of(text, dict.fromkeys(coverage.QUANTITIES.values(), (0, 1 << 60)))[1] == 0
    assert sum(line.startswith("   2 of") for line in lines) == len(coverage.QUANTITIES)
    assert sum("no probe" in line for line in lines) == len(lines) - 1 - len(coverage.QUANTITIES)


def test_a_hole_is_shown() -> None:
    sites = coverage.probed().sites
    place = next(n for n, site in enumerate(sites) if site.function == "RSHIFT_ROUND")
    reaching = [["a", "b"] for _ in sites]
    assert coverage.report(sites, reaching)[1] == 0
    reaching[place] = []
    lines, holes = coverage.report(sites, reaching)
    assert holes == 1
    assert any(f"line {sites[place].line}: {sites[place].text}" in line for line in lines)
    for n, site in enumerate(sites):
        if site.function in coverage.IMAGES:
            reaching[n] = []
    assert coverage.report(sites, reaching)[1] == 1


def test_a_file_reaches_what_it_has() -> None:
    """The example is accepted: no test of REQUIRE is false. A cut file stops early."""
    sites = coverage.probed().sites
    own = {sites[n] for n in coverage.reached(DATA)[0]}
    refusing = [site for site in own if site.function == "REQUIRE" and "raise" in site.text]
    refusals = [site for site in refusing if site.kind == coverage.LINE]
    assert not refusals
    assert {sites[n] for n in coverage.reached(DATA[:9])[0]} - own
    assert len(coverage.reached(DATA[:9])[0]) < len(own) / 4


def test_a_comparison_at_its_bound() -> None:
    """A comparison shows whether its last number held, and whether the first one beyond failed."""
    own = coverage.probed()
    check, wanted = own.names["CHECK_SUBSTREAM"], ("CHECK_SUBSTREAM", "length >= 8 + 4 * lanes", coverage.AT)
    at = next(n for n, site in enumerate(own.sites) if (site.function, site.text, site.kind) == wanted)
    assert own.sites[at + 1].kind == coverage.BEYOND
    for length, seen in ((13, [0, 0]), (12, [1, 0]), (10, [0, 0]), (11, [0, 1])):
        own.seen[:] = bytes(len(own.seen))
        with contextlib.suppress(own.names["Refused"]):
            check([0] * 8 + [0, 0, 1, 0, 0], 0, length, 1)
        assert list(own.seen[at : at + 2]) == seen


def _with_value(path: str, change: int) -> bytes:
    """The example with another number, and without right checksums."""
    row = next(row for row in rows(DATA) if row.path == path)
    return DATA[: row.start] + (row.value + change).to_bytes(row.end - row.start, "little") + DATA[row.end :]


def test_extremes_of_elements(tmp_path: Path) -> None:
    """An extreme is proved by the end of the type, or by a refused file with the next value, and by nothing else."""
    path, name = "header.render_info.up_axis", "RenderInfo.up_axis"
    row = next(row for row in rows(DATA) if row.path == path)
    manifest = replace(SUITE, vectors=(EXAMPLE,))
    own = elements.of_vectors(manifest)[name]
    assert (own.least, own.greatest) == (row.value, row.value)
    assert own.ends()[1] is None

    def kept(path: str, **more: Any) -> Any:
        return structs.replace(EXAMPLE, input=structs.replace(EXAMPLE.input, path=path), **more)

    for change, offset, proof in ((1, row.start, "refused"), (2, row.start, None), (1, row.start + 1, None)):
        (tmp_path / "refused.c3gs").write_bytes(_with_value(path, change))
        (tmp_path / "example.c3gs").write_bytes(DATA)
        refusal = Rejected(214, "header.render_info", offset, "6.5")
        vectors = kept("example.c3gs"), kept("refused.c3gs", id="refused", expectation=refusal)
        ranges = elements.of_vectors(replace(manifest, vectors=vectors, folder=tmp_path))
        assert ranges[name].ends()[1] == proof
    lines, holes = elements.report(SPEC.read_text(encoding="utf-8"), manifest)
    assert holes > 0
    assert any(line.startswith("  Frame.low: no vector has it") for line in lines) == (
        not any(row.path == "frame.low[0]" for row in rows(DATA))
    )


def test_no_element_is_without_its_extremes() -> None:
    lines, holes = elements.report(SPEC.read_text(encoding="utf-8"), SUITE)
    assert holes == 0, [line for line in lines if "open" in line or "no vector" in line]
    known = {line.strip().partition(":")[0] for line in lines}
    assert {name for name in elements.ARGUED if "." in name} <= known


def test_neighbouring_checks_have_a_vector_with_both_faults() -> None:
    lines, unmet = neighbours.report(SUITE)
    assert not unmet, [line for line in lines if line.endswith("open")]
    assert len(lines) > 150
    assert all(any(line.endswith(reason) for line in lines) for reason in neighbours.ARGUED.values())
    # One vector has no two faults.
    assert neighbours.report(replace(SUITE, vectors=(EXAMPLE,)))[1] > 50


def test_command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    small = replace(SUITE, vectors=(EXAMPLE,))
    reaching, _ = coverage.of_vectors(small, 1)
    assert {name for names in reaching for name in names} == {coverage.ANY_FILE, EXAMPLE.id}
    monkeypatch.setattr(coverage, "load", lambda: small)
    assert coverage.main(1) == 1
    assert "REQUIRE" in capsys.readouterr().out
