"""The manual: pages by job, SPEC.md by chapters, and the command that builds a site of them with Sphinx."""
