"""The tools of SPEC.md: they make what SPEC.md and files beside it hold of the code, and check that it is current."""
