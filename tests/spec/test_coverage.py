"""The coverage of SPEC.md's blocks by the vectors. tests/conformance/test_vectors.py proves that there is no hole."""

from __future__ import annotations

from dataclasses import replace

import pytest

from conformance import spec_decoder
from conformance.manifest import load
from spec import coverage
from spec.coverage import (
    FALSE,
    IMAGES,
    LINE,
    QUANTITIES,
    TOO_LARGE,
    TRUE,
    extremes_of,
    of_vectors,
    probed,
    reached,
    report,
)
from spec.decoder import SPEC

SUITE = load()
EXAMPLE = next(vector for vector in SUITE.vectors if vector.id == "valid-worked-example")
DATA = (SUITE.folder / EXAMPLE.input.path).read_bytes()


def test_probes_change_nothing() -> None:
    probes = probed()
    for data in (DATA, DATA[:-1], b""):
        found, error = spec_decoder.verdict(probes.names, data)
        own, wrong = spec_decoder.verdict(spec_decoder.names(), data)
        assert (found, error) == (own, wrong)
    assert {site.kind for site in probes.sites} == {LINE, TRUE, FALSE}
    assert {site.function for site in probes.sites} >= IMAGES
    assert probes.extremes["accumulator of a row"][1] < 1 << 24


def test_each_quantity_has_its_bound() -> None:
    text = SPEC.read_text(encoding="utf-8")
    lines, unreached = extremes_of(text, dict.fromkeys(QUANTITIES.values(), (-3, 2)))
    assert unreached == len(QUANTITIES) - len(TOO_LARGE)
    assert extremes_of(text, dict.fromkeys(QUANTITIES.values(), (0, 1 << 60)))[1] == 0
    assert sum(line.startswith("   2 of") for line in lines) == len(QUANTITIES)
    assert sum("no probe" in line for line in lines) == len(lines) - 1 - len(QUANTITIES)


def test_a_hole_is_shown() -> None:
    sites = probed().sites
    place = next(n for n, site in enumerate(sites) if site.function == "RSHIFT_ROUND")
    found = [["a", "b"] for _ in sites]
    assert report(sites, found)[1] == 0
    found[place] = []
    lines, holes = report(sites, found)
    assert holes == 1
    assert any(f"line {sites[place].line}: {sites[place].text}" in line for line in lines)
    for n, site in enumerate(sites):
        if site.function in IMAGES:
            found[n] = []
    assert report(sites, found)[1] == 1


def test_a_file_reaches_what_it_has() -> None:
    """The example is accepted: no test of REQUIRE is false. A cut file stops early."""
    sites = probed().sites
    own = {sites[n] for n in reached(DATA)[0]}
    refusals = [site for site in own if site.function == "REQUIRE" and site.kind == LINE and "raise" in site.text]
    assert not refusals
    assert {sites[n] for n in reached(DATA[:9])[0]} - own
    assert len(reached(DATA[:9])[0]) < len(own) / 4


def test_command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    small = replace(SUITE, vectors=(EXAMPLE,))
    found, _ = of_vectors(small, 1)
    assert {name for names in found for name in names} == {"any file", EXAMPLE.id}
    monkeypatch.setattr(coverage, "load", lambda: small)
    assert coverage.main(1) == 1
    assert "REQUIRE" in capsys.readouterr().out
