"""The manual: pages by job, and the command that builds a site of them with Sphinx, with SPEC.md on one page."""
