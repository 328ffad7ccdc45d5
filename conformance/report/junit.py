"""The record as JUnit XML, for continuous integration."""

from __future__ import annotations

from collections import Counter
from typing import Any
from xml.etree import ElementTree

_ELEMENTS = {"failed": "failure", "unexpected": "failure", "crashed": "error", "skipped": "skipped", "known": "skipped"}


def document(record: dict[str, Any]) -> str:
    """Returns a test suite for each class of vectors, with a test case for each vector. Known failures are skipped.

    All texts of a record are printable (record.build), and thus allowed in XML.
    """
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
                found = ElementTree.SubElement(case, element, message=v["text"])
                found.text = "\n".join([*v["divergence"], *v["hex"], v["stderr"]])
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"
