"""Chooses the tests of `./run-tests --smoke`: for each requirement of SPEC.md the fastest test that is marked with it.

python tests/smoke/choose.py    runs the quick tests with a requirement, and writes chosen.txt if they all pass
"""

import sys
import time
from collections import defaultdict
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
CHOSEN = Path(__file__).with_name("chosen.txt")
# These run whole: a case for each error, and one for each command.
WHOLE = ("tests/conformance/test_decoders.py::test_fault", "tests/smoke/test_each_command.py")


class Durations:
    """Runs only quick tests with requirements. seconds, names: of a processor, and requirements, by test."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self.names: dict[str, set[str]] = {}

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        for item in list(items):
            names = {name for mark in item.iter_markers("requirement") for name in mark.args}
            if not names or item.get_closest_marker("slow") or item.nodeid.startswith(WHOLE):
                items.remove(item)
            else:
                self.names[item.nodeid] = names

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_call(self, item: pytest.Item):
        began = time.process_time()
        yield
        self.seconds[item.nodeid] += time.process_time() - began

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.outcome != "passed":
            self.names.pop(report.nodeid, None)


def chosen(seconds: dict[str, float], names: dict[str, set[str]]) -> list[str]:
    """Returns tests that have all requirements: first the fastest for those that the fewest tests have."""
    picked: set[str] = set()
    by_name = {name: [test for test in names if name in names[test]] for test in names for name in names[test]}
    for tests in sorted(by_name.values(), key=lambda tests: (len(tests), tests)):
        if not picked & set(tests):
            picked.add(min(tests, key=lambda test: (seconds[test], test)))
    return sorted([*WHOLE, *picked])


if __name__ == "__main__":
    durations = Durations()
    status = pytest.main(["-q", "-p", "no:cacheprovider", str(ROOT / "tests")], plugins=[durations])
    if status == pytest.ExitCode.OK:
        CHOSEN.write_text("\n".join(chosen(durations.seconds, durations.names)) + "\n", encoding="utf-8")
    sys.exit(status)
