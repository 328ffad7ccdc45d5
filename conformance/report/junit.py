"""The record as JUnit XML, for continuous integration."""

from __future__ import annotations

from collections import Counter
from xml.etree import ElementTree

from .schema import Record

_ELEMENTS = {"failed": "failure", "unexpected": "failure", "crashed": "error", "skipped": "skipped", "known": "skipped"}


def document(record: Record) -> str:
    """Returns a test suite for each class of vectors, with a test case for each vector. Known failures are skipped.

    All texts of a record are printable (record.build), and thus allowed in XML.
    """
    root = ElementTree.Element("testsuites", name="C3GS conformance")
    for klass in dict.fromkeys(v.klass for v in record.vectors):
        own = [v for v in record.vectors if v.klass == klass]
        kinds = Counter(_ELEMENTS.get(v.status) for v in own)
        counts = {"failures": "failure", "errors": "error", "skipped": "skipped"}
        numbers = {"tests": str(len(own)), **{name: str(kinds[kind]) for name, kind in counts.items()}}
        seconds = f"{sum(v.seconds for v in own):.3f}"
        suite = ElementTree.SubElement(root, "testsuite", {"name": klass, "time": seconds, **numbers})
        for v in own:
            case = ElementTree.SubElement(
                suite, "testcase", name=v.id, classname=f"c3gs.{klass}", time=f"{v.seconds:.3f}"
            )
            if element := _ELEMENTS.get(v.status):
                fault = ElementTree.SubElement(case, element, message=v.text)
                fault.text = "\n".join([*v.divergence, *v.hex, v.stderr])
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"
