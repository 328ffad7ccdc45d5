"""SPEC.md's own tools: what in it, and beside it, is made from the code, and the check that all of it is current."""
