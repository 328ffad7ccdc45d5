"""The house stands as ARCHITECTURE.md draws it: rooms in one order, and the same modules in both decoders."""

from __future__ import annotations

import re
from graphlib import CycleError, TopologicalSorter

import pytest

from spec.house import ROOMS, docstring, imports, modules, room

BITSTREAM, INDEPENDENT = "refcodec.bitstream", "conformance.independent"
NATIVE = "refcodec.native"
# The reference decodes chunks side by side, some at a time, takes the bounds of its callers, and has a native kernel.
ONLY_REFERENCE = {"batches", "bounds", "kernel", "streaming"}
# The second decoder's own command, trace and probes. Those of the reference are in refcodec.cli and refcodec.inspect.
ONLY_INDEPENDENT = {"__main__", "trace", "probes"}
# What decoding must not need. plyfile and safetensors belong to the scene folder.
HEAVY = {"torch", "numba", "scipy", "plyfile", "safetensors", "tqdm", "PIL", "skimage"}
# The second decoder reads whole files alone. It passes over metadata and cameras, on which no verdict depends.
LEFT_OUT = {"reader", "source", "ancillary", "metadata", "cameras"}


def test_a_room_uses_those_below_it() -> None:
    above = {
        (module, name)
        for module in modules()
        for name in imports(module)
        if ROOMS.index(room(name)) > ROOMS.index(room(module))
    }
    assert above == set()


def test_no_circle() -> None:
    """No modules import each other, neither at their top nor within functions."""
    try:
        TopologicalSorter({name: set(imports(name)) for name in modules()}).prepare()
    except CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


def test_the_bitstream_side_stands_alone() -> None:
    """It uses no other room than the native kernel and the one of statuses and files, and no heavy package."""
    for module in modules():
        if module.startswith((BITSTREAM, NATIVE)):
            below = {NATIVE, "refcodec"} | ({BITSTREAM} if module.startswith(BITSTREAM) else set())
            assert {room(name) for name in imports(module)} <= below, module
            text = modules()[module].read_text(encoding="utf-8")
            assert not set(re.findall(r"^\s*(?:from|import) (\w+)", text, re.MULTILINE)) & HEAVY, module


def test_the_second_decoder_stands_alone() -> None:
    """It shares no line with the first."""
    for module in modules():
        if module.startswith(INDEPENDENT):
            assert {room(name) for name in imports(module)} <= {INDEPENDENT}, module


def _modules(package: str) -> set[str]:
    return {name.removeprefix(f"{package}.") for name in modules() if name.startswith(f"{package}.")}


def test_both_decoders_have_the_same_modules() -> None:
    """There is one module for each group of clauses, under one name, and it names the clauses first."""
    first, second = _modules(BITSTREAM), _modules(INDEPENDENT)
    assert first - second == ONLY_REFERENCE | LEFT_OUT
    assert second - first == ONLY_INDEPENDENT
    for name in sorted(second & first):
        clauses = [docstring(f"{package}.{name}").partition(":")[0] for package in (BITSTREAM, INDEPENDENT)]
        assert clauses[0] == clauses[1], name


def test_what_is_private_stays_in_its_module() -> None:
    for module in modules():
        taken = {name for names in imports(module).values() for name in names if name.startswith("_")}
        assert {name for name in taken if not name.endswith("__")} == set(), module
