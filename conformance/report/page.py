"""The record as one HTML page that loads no other files."""

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
    # The filter `capitalize` of jinja2 would change the case of names.
    environment.filters["capitalised"] = lambda text: text[:1].upper() + text[1:]
    return environment.from_string(_TEMPLATE.read_text(encoding="utf-8"))


def document(record: dict[str, Any]) -> str:
    """Returns the page: verdicts, then vectors, failures first, in the order of `most_telling`."""
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
