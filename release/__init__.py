"""Everything that people download, built from one commit by one command, twice the same. RELEASING.md has the steps.

Nothing is published and nothing is signed. The package works on a clone, and needs `pip install -e '.[release]'`.
"""
