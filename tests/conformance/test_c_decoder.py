"""The decoder in C (conformance/c): its results equal those of refcodec, without sanitizer reports."""

from __future__ import annotations

from pathlib import Path

import pytest
from c_program import Program
from hostile_files import UNDRAWN, largest_planes
from hypothesis import given, settings
from hypothesis import strategies as st
from test_spec_decoder import faulty

from conformance.fuzz import compare
from refcodec.bitstream import codec, reconstruction
from refcodec.bitstream.errors import REGISTRY

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.no_cover
@pytest.mark.parametrize("name", REGISTRY)
@settings(max_examples=3)
@given(st.data())
def test_fault(c_decoder: Program, name: str, data: st.DataObject) -> None:
    fault = data.draw(faulty(name))
    assert c_decoder.verdict(fault.data) == (name, fault.offset)


@pytest.mark.slow
@pytest.mark.no_cover
@given(compare.families())
@settings(max_examples=10)
def test_it_agrees(c_decoder: Program, made: list[tuple[bytes, compare.Verdict | None]]) -> None:
    for data, _ in made:
        assert c_decoder.verdict(data) == compare.first_verdict(data)


@pytest.mark.no_cover
def test_other_render_models(c_decoder: Program) -> None:
    assert c_decoder.verdict(codec.emit(UNDRAWN)) == (reconstruction.digest(UNDRAWN)[0], -1)


@pytest.mark.slow
@pytest.mark.no_cover
def test_the_largest_planes(c_decoder: Program) -> None:
    scene = largest_planes()
    assert c_decoder.verdict(codec.emit(scene)) == (reconstruction.digest(scene)[0], -1)


def test_the_example(c_decoder: Program) -> None:
    data = (ROOT / "vectors" / "tiny-example.c3gs").read_bytes()
    assert c_decoder.verdict(data) == (reconstruction.digest(codec.parse(data).scene)[0], -1)
