"""The tests of `./run-tests --smoke`: one for each requirement and each command. choose.py makes their list."""

import re
import subprocess
import sys

import pytest
from choose import CHOSEN, WHOLE, chosen
from test_each_command import COMMANDS

from refcodec.inspect.specification import own_requirements
from spec.made import ROOT
from spec.trail import proofs


def test_each_requirement_has_a_test() -> None:
    """But those that only slow tests have. Each error has a case of test_fault."""
    lines = CHOSEN.read_text(encoding="utf-8").splitlines()
    assert lines == sorted(set(lines))
    assert set(WHOLE) <= set(lines)
    functions = {tuple(line.partition("[")[0].split("::")) for line in lines if "::" in line}
    for path, name in functions:
        assert f"\ndef {name}(" in (ROOT / path).read_text(encoding="utf-8"), f"{path} has no {name}"
    by_requirement = proofs()[0]
    missing = {
        name
        for name, requirement in own_requirements().items()
        if not requirement.error and not any((place.path, place.name) in functions for place in by_requirement[name])
    }
    assert missing == set()


@pytest.mark.slow
def test_the_chosen_tests_can_be_run() -> None:
    """Their names have parameters, which a change of their table can rename."""
    words = [sys.executable, "-m", "pytest", "-q", "--collect-only", "-p", "no:cacheprovider", f"@{CHOSEN}"]
    assert subprocess.run(words, cwd=ROOT, capture_output=True, check=False).returncode == 0


def test_each_command_has_a_test() -> None:
    """Of the public list, which `python -m spec` makes from the parsers."""
    listed = re.findall(
        r"^((?:refcodec|conformance) [a-z-]+) ", (ROOT / "spec" / "public.txt").read_text(), re.MULTILINE
    )
    assert [" ".join(words[:2]) for words, _ in COMMANDS] == sorted(listed)


def test_the_fastest_test_is_chosen() -> None:
    """Where another requirement has chosen a test, it is not chosen twice."""
    seconds = {"a": 3.0, "b": 1.0, "c": 2.0}
    assert chosen(seconds, {"a": {"R1"}, "b": {"R2"}, "c": {"R2", "R3"}}) == sorted([*WHOLE, "a", "c"])
