"""Sphinx for the manual: `python -m docs` runs it on the repository with this file.

Links between Markdown files are paths, as code hosts follow them, thus the site has the folders of the repository.
"""

import re
from pathlib import Path
from typing import Any

from docs import commands
from refcodec import __version__

project = "C3GS"
author = "The C3GS maintainers"
copyright = author
release = version = __version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
html_theme = "furo"
html_title = "C3GS"
html_copy_source = False
# Options begin with two hyphens, which are no dash.
smartquotes = False
html_show_sphinx = False
# Links lead to headings by the anchors that code hosts give them.
myst_heading_anchors = 4
default_role = "py:obj"
autodoc_member_order = "bysource"
autodoc_typehints = "description"
# Some languages of code blocks have no colours, and some pages are reached by links only.
suppress_warnings = ["misc.highlighting_failure", "toc.not_included"]

_LINK = re.compile(r"\[([^\[\]]*)\]\(([^)#\s]+)\)")
root_doc = "docs/index"
# The pages in their order.
ORDER = {
    "First steps": ("first-steps", "look-inside", "commands", "python", "python-names"),
    "By job": ("photographs", "method", "models", "page", "programs", "comparison", "decoder", "certify", "extend"),
    "Specification": ("specification", "/SPEC"),
    "More": (
        *("/ARCHITECTURE", "/CONTRIBUTING", "/CHANGELOG", "/SECURITY", "/conformance/README", "/vectors/README"),
        *("/benchmarks/RESULTS", "/refcodec/viewer/README", "/refcodec/web/README"),
    ),
}
_FOLDERS = ("docs", "conformance", "vectors", "benchmarks", "refcodec", "examples", "spec")
include_patterns = ["*.md", *(f"{folder}/**.md" for folder in _FOLDERS)]


def _complete(app: Any, name: str, source: list[str]) -> None:
    """Adds the contents to the first page, and the help of all commands to theirs. Folders have no pages to link to."""
    folder = Path(app.srcdir, name).parent
    source[0] = _LINK.sub(lambda link: link[1] if (folder / link[2]).is_dir() else link[0], source[0])
    if name == root_doc:
        for caption, pages in ORDER.items():
            lines = "\n".join(pages)
            source[0] += f"\n```{{toctree}}\n:hidden:\n:maxdepth: 1\n:caption: {caption}\n\n{lines}\n```\n"
    source[0] = source[0].replace("<!-- commands -->\n", commands.sections())


def setup(app: Any) -> None:
    """Adds the hook."""
    app.connect("source-read", _complete)
