"""The record as one HTML page that needs nothing else."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import jinja2

from ..runner.grading import GRADES
from .schema import STATUSES
from .summary import most_telling

_TEMPLATE = Path(__file__).with_name("page.html")


@cache
def _template() -> jinja2.Template:
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    # Only the first letter: a sentence may begin with a name.
    environment.filters["capitalised"] = lambda text: text[:1].upper() + text[1:]
    return environment.from_string(_TEMPLATE.read_text(encoding="utf-8"))


def document(record: dict[str, Any]) -> str:
    """The page: verdicts, then the vectors, what failed first, and of that what tells most."""
    order = {status: i for i, status in enumerate(STATUSES)}
    failed = most_telling(record["vectors"])
    rank = {v["id"]: i for i, v in enumerate(failed)}
    vectors = sorted(record["vectors"], key=lambda v: (order[v["status"]], rank.get(v["id"], 0)))
    holes = [(name, row) for name, row in record["requirements"].items() if row["right"] < row["vectors"]]
    right_features = sum(row["right"] == row["vectors"] for row in record["features"].values())
    return _template().render(
        r=record,
        vectors=vectors,
        bad=len(failed),
        grades=GRADES,
        best=max(GRADES),
        statuses=STATUSES,
        holes=holes,
        right_features=right_features,
    )
