"""The record as JUnit XML, which continuous integration shows."""

from __future__ import annotations

import re
from collections import Counter
from typing import Any
from xml.etree import ElementTree

# Characters that XML 1.0 does not allow.
_FORBIDDEN = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_ELEMENTS = {"failed": "failure", "unexpected": "failure", "crashed": "error", "skipped": "skipped", "known": "skipped"}


def _clean(text: str) -> str:
    return _FORBIDDEN.sub("\N{REPLACEMENT CHARACTER}", text)


def document(record: dict[str, Any]) -> str:
    """A test suite for each class of vectors, a test case for each vector; a known failure counts as skipped."""
    root = ElementTree.Element("testsuites", name="C3GS conformance")
    for klass in dict.fromkeys(v["class"] for v in record["vectors"]):
        entries = [v for v in record["vectors"] if v["class"] == klass]
        kinds = Counter(_ELEMENTS.get(v["status"]) for v in entries)
        suite = ElementTree.SubElement(
            root,
            "testsuite",
            name=klass,
            time=f"{sum(v['seconds'] for v in entries):.3f}",
            tests=str(len(entries)),
            failures=str(kinds["failure"]),
            errors=str(kinds["error"]),
            skipped=str(kinds["skipped"]),
        )
        for v in entries:
            case = ElementTree.SubElement(
                suite, "testcase", name=v["id"], classname=f"c3gs.{klass}", time=f"{v['seconds']:.3f}"
            )
            element = _ELEMENTS.get(v["status"])
            if element:
                found = ElementTree.SubElement(case, element, message=_clean(v["text"]))
                found.text = _clean("\n".join([*v["divergence"], *v["hex"], v["stderr"]]))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"
