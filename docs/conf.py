"""Sphinx for the manual. `python -m docs` puts the pages together, and runs Sphinx on them with this file."""

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
