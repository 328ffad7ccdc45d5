"""The imports between packages follow the order in ARCHITECTURE.md."""

import re
from collections import Counter
from graphlib import CycleError, TopologicalSorter

import pytest

from spec.house import ROOMS, ROOT, imports, modules, room

BITSTREAM, SECOND = "refcodec.bitstream", "conformance.spec_decoder"
NATIVE = "refcodec.native"
# What decoding must not need. plyfile and safetensors belong to the scene folder.
HEAVY = {"torch", "numba", "scipy", "plyfile", "safetensors", "tqdm", "PIL", "skimage", "jinja2"}


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
    """It imports nothing of the first."""
    for module in modules():
        if module.startswith(SECOND):
            assert {room(name) for name in imports(module)} <= {SECOND}, module


def test_what_is_private_stays_in_its_module() -> None:
    for module in modules():
        taken = {name for names in imports(module).values() for name in names if name.startswith("_")}
        assert {name for name in taken if not name.endswith("__")} == set(), module


def test_test_files_have_names_of_their_own() -> None:
    """pytest imports a test file by its name alone: two of one name fail only where both are collected."""
    names = Counter(path.name for path in (ROOT / "tests").rglob("*.py") if path.name != "conftest.py")
    assert [name for name, count in names.items() if count > 1] == []
