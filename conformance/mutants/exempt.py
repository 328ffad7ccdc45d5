"""Mutants that no vector catches: exempt.json has the mutants of each reason.

PROOFS: those that are right decoders, each with the proof that no file distinguishes it from the unchanged one.
GAPS: wrong decoders, each with a file that would distinguish it, and that the suite does not have. They are not counted
as planted bugs. A later suite should have such files.
"""

import json
from pathlib import Path

_REASONS = json.loads(Path(__file__).with_name("exempt.json").read_text(encoding="utf-8"))
PROOFS, GAPS = (
    {name: reason for reason, names in _REASONS[kind].items() for name in names.split()} for kind in ("proofs", "gaps")
)
