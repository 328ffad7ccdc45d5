"""Tools of SPEC.md: they generate its parts and related files from the code, and check that they are current."""
