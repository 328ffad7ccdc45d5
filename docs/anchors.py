"""Permanent anchors on the pages of SPEC.md: `#6.7` of a clause, `#R6.7-1` of a requirement, `#e401` of an error.

An extension of Sphinx. It also makes each of them an entry of the index, which the search finds, and links each
requirement and error to its vectors.
"""

from __future__ import annotations

import re

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.transforms import SphinxTransform

from refcodec.bitstream.errors import REGISTRY
from refcodec.inspect import specification

from . import chapters, vectors

_HEADING = re.compile(rf"(?:Annex )?({specification.CLAUSE}):? ")
_REQUIREMENTS = {chapters.place_of(name): name for name in specification.own_requirements()}
_NAMES = {str(error.code): error.name for error in REGISTRY.values()}


class Anchors(SphinxTransform):
    """Gives the elements of a chapter their anchors."""

    # Behind the transforms that give elements other anchors, and before the one that collects the targets of links.
    default_priority = 845

    def apply(self, **kwargs: object) -> None:
        """Changes the document, if it is a chapter."""
        if self.env.docname not in {f"spec/{chapter.name}" for chapter in chapters.chapters()}:
            return
        slugs = self.env.metadata[self.env.docname]["myst_slugs"]
        for section in self.document.findall(nodes.section):
            heading = _HEADING.match(section[0].astext())
            if heading:
                # Other anchors than those of code hosts depend on the words of other headings.
                section["ids"] = [heading[1], section["slug"]] if "slug" in section else [heading[1]]
                if "slug" in section:
                    line, _, title = slugs[section["slug"]]
                    slugs[section["slug"]] = line, heading[1], title
        for paragraph in list(self.document.findall(nodes.paragraph)):
            for place in paragraph["ids"][:1]:
                if place in _REQUIREMENTS:
                    self._requirement(paragraph, place, _REQUIREMENTS[place])
        if self.env.docname == f"spec/{chapters.page_of('103-registry')}":
            for row in list(self.document.findall(nodes.row)):
                if row[0].astext() in _NAMES and row[1].astext() == _NAMES[row[0].astext()]:
                    self._error(row)

    def _requirement(self, paragraph: nodes.paragraph, place: str, name: str) -> None:
        paragraph["ids"].insert(0, name)
        self.document.ids[name] = paragraph
        # Links lead to it.
        self.document.nameids[place] = name
        mark = next(paragraph.findall(nodes.strong))
        mark[:] = [nodes.reference("", mark.astext(), refid=name)]
        link = _vectors(name, vectors.counted(len(vectors.by_name()[name])))
        paragraph.insert(paragraph.index(mark) + 1, [nodes.Text(" "), nodes.superscript("", "", link)])
        paragraph.parent.insert(0, _entry(name, name))

    def _error(self, row: nodes.row) -> None:
        code, name = row[0].astext(), row[1].astext()
        row["ids"] = [f"e{code}"]
        row[0][0][:] = [_vectors(f"e{code}", code)]
        row[0].insert(0, [_entry(code, f"e{code}"), _entry(name, f"e{code}")])


def _vectors(name: str, words: str) -> nodes.reference:
    return nodes.reference("", words, refuri=f"vectors.html#{name}", internal=True)


def _entry(words: str, anchor: str) -> addnodes.index:
    # The search shows main entries first.
    return addnodes.index(entries=[("single", words, anchor, "main", None)])


def setup(app: Sphinx) -> dict[str, bool]:
    """Adds the extension."""
    app.add_transform(Anchors)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
