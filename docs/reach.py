"""The vectors of each line of SPEC.md's blocks, on the pages of SPEC.md: numbers beside the code, and a table below it.

An extension of Sphinx. It shows the record that `python -m spec --coverage --write` makes, or of the variable
C3GS_COVERAGE. Without a record of this SPEC.md and these vectors, the blocks are plain code.
"""

from __future__ import annotations

import json
import os
import re
from functools import cache
from html import escape
from itertools import groupby
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.transforms import SphinxTransform

from conformance import manifest
from refcodec.inspect import specification
from spec.coverage import RECORD, versions
from spec.decoder import TARGET

from . import chapters, vectors

# Of a line: how many vectors reach it, and the names of some, or why none does. None: it is not a statement's first.
Reach = tuple[int, tuple[str, ...]] | str | None
_STYLE = """<style>
.reach { display: inline-block; width: 6ch; margin-right: 2ch; text-align: right; user-select: none;
  color: var(--color-foreground-muted); }
.reach::before { content: attr(data-count); }
details.reached { margin: -0.5rem 0 1rem; }
details.reached table { border-collapse: collapse; font-size: var(--code-font-size); }
details.reached td { vertical-align: top; padding: 0.2rem 1rem 0.2rem 0; border-bottom: 1px solid;
  border-color: var(--color-background-border); }
details.reached pre { margin: 0; padding: 0; white-space: pre-wrap; background: none; }
</style>"""


@cache
def by_block() -> dict[str, list[Reach]]:
    """Returns what reaches each line of each block of SPEC.md, by the text of the block."""
    path = Path(os.environ.get("C3GS_COVERAGE", RECORD))
    made = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {"lines": {}}
    record = made["lines"] if versions().items() <= made.items() else {}
    names = [vector.id for vector in manifest.load().vectors]
    source = TARGET.read_text(encoding="utf-8").splitlines()
    found: dict[str, list[Reach]] = {}
    at = 0
    for block in re.findall(r"^```python\n(.*?)^```", specification.text(), re.DOTALL | re.MULTILINE):
        lines = block.rstrip("\n").splitlines()
        at = source.index(lines[0], at)
        reached: list[Reach] = []
        for line in lines:
            # The module cites clauses between the lines of a block.
            while source[at] != line:
                at += 1
            at += 1
            entry = record.get(str(at))
            reached.append((entry[0], tuple(names[place] for place in entry[1:])) if isinstance(entry, list) else entry)
        found[block.rstrip("\n")] = reached
    return found


class Block(nodes.literal_block):
    """A block of Python with what reaches its lines, in the attribute `reach`."""


class Blocks(SphinxTransform):
    """Replaces the blocks of a chapter."""

    default_priority = 850

    def apply(self, **kwargs: Any) -> None:
        """Changes the document, if it is a chapter."""
        if self.env.docname not in {f"spec/{chapter.name}" for chapter in chapters.chapters()}:
            return
        for block in list(self.document.findall(nodes.literal_block)):
            reach = by_block().get(block.astext().rstrip("\n"))
            if reach and any(reach):
                block.replace_self(Block(block.rawsource, block.astext().rstrip("\n"), reach=reach))


def _words(reach: tuple[int, tuple[str, ...]] | str) -> str:
    """Returns what reaches a line, in words."""
    if isinstance(reach, str):
        return f"argued: {reach}"
    count, names = reach
    return f"{vectors.counted(count)}{f', such as {names[0]}' if names else ': every decoder runs it at its start'}"


def html(code: str, highlighted: str, reach: list[Reach]) -> str:
    """Returns a block as HTML. highlighted: its lines in HTML. reach: what reaches each of them."""
    shown, rows = [], []
    for line, own in zip(highlighted.splitlines(), reach, strict=True):
        count = "" if own is None else own[0] if isinstance(own, tuple) else "argued"
        title = "" if own is None else f' title="{escape(_words(own))}"'
        # The number is not in the text, so that copies of the code do without. The table says the same.
        shown.append(f'<span class="reach" data-count="{count}"{title} aria-hidden="true"></span>{line}\n')
    # A line without a number begins a function, or continues the statement above it.
    statements = [(line.strip(), own) for line, own in zip(code.splitlines(), reach, strict=True) if own is not None]
    for own, run in groupby(statements, key=lambda pair: pair[1]):
        text = "\n".join(line for line, _ in run)
        names = own[1] if isinstance(own, tuple) else ()
        what = vectors.counted(own[0]) if isinstance(own, tuple) and names else _words(own)
        more = " and others" if isinstance(own, tuple) and own[0] > len(names) > 0 else ""
        cells = f"<td><pre>{escape(text)}</pre></td><td>{escape(what)}</td><td>{escape(', '.join(names))}{more}</td>"
        rows.append(f"<tr>{cells}</tr>\n")
    block = f'<div class="highlight"><pre>{"".join(shown)}</pre></div>'
    table = f"<summary>Vectors that reach these lines</summary>\n<table>\n{''.join(rows)}</table>"
    details = f'<details class="reached">{table}</details>\n' if rows else ""
    return f'<div class="highlight-python notranslate">{block}</div>\n{details}'


def _visit(translator: Any, node: Block) -> None:
    code = node.astext()
    marked = translator.highlighter.highlight_block(code, "python", location=node)
    lines = marked.partition("<pre>")[2].rpartition("</pre>")[0].removeprefix("<span></span>")
    translator.body.append(html(code, lines, node["reach"]))
    raise nodes.SkipNode


def _styled(app: Sphinx, page: str, template: str, context: dict[str, Any], tree: nodes.document | None) -> None:
    if page.startswith("spec/"):
        context["metatags"] = context.get("metatags", "") + _STYLE


def setup(app: Sphinx) -> dict[str, bool]:
    """Adds the extension."""
    app.add_node(Block, html=(_visit, None))
    app.add_transform(Blocks)
    app.connect("html-page-context", _styled)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
