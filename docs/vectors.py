"""The page of the vectors of each requirement and of each error, from the manifest of the suite."""

from __future__ import annotations

from functools import cache
from html import escape

from conformance import manifest
from refcodec.bitstream.errors import REGISTRY
from refcodec.inspect import specification

from . import chapters

_TOP = """# Vectors of each requirement and error

The [conformance suite](../conformance/README.md) tests the requirements of [SPEC.md](../SPEC.md) with these files.
"""


@cache
def by_name() -> dict[str, list[manifest.Vector]]:
    """Returns the vectors of each requirement, such as R6.7-1, and then of each error, such as e401."""
    names = [*specification.own_requirements(), *(f"e{error.code}" for error in REGISTRY.values())]
    found: dict[str, list[manifest.Vector]] = {name: [] for name in names}
    for vector in manifest.load().vectors:
        for name in vector.requirements:
            found[name].append(vector)
        if isinstance(vector.expectation, manifest.Rejected):
            found[f"e{vector.expectation.code}"].append(vector)
    return found


def counted(count: int) -> str:
    """Returns a number of vectors in words."""
    return "no vectors" if count == 0 else "1 vector" if count == 1 else f"{count} vectors"


def page() -> str:
    """Returns the page, in Markdown. Its tables are HTML, because there are thousands of rows."""
    requirements, errors = specification.own_requirements(), {f"e{error.code}": error for error in REGISTRY.values()}
    parts = [_TOP]
    for name, vectors in by_name().items():
        error = errors.get(name)
        words = f"{error.name}: {error.text}" if error else requirements[name].text
        home = chapters.page_of("103-registry" if error else chapters.place_of(name))
        parts.append(f'<h2 id="{name}"><a href="{home}.html#{name}">{name}</a></h2>\n')
        parts.append(f"<p>{escape(words)} ({counted(len(vectors))})</p>\n")
        if vectors:
            parts.append("<table>\n<tr><th>id</th><th>title</th><th>class</th><th>expected error</th></tr>")
            parts += [_row(vector) for vector in vectors]
            parts.append("</table>\n")
    return "\n".join(parts)


def _row(vector: manifest.Vector) -> str:
    expected = vector.expectation
    error = ""
    if isinstance(expected, manifest.Rejected):
        error = f"{expected.code} {expected.name} at {expected.offset}"
    cells = (escape(vector.id), escape(vector.title), vector.klass, error)
    return f"<tr>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>"
