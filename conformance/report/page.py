"""The record as one HTML page that loads no other files."""

from pathlib import Path

from msgspec import to_builtins

from refcodec.pages.environment import render

from ..runner.run import STATUSES
from .schema import Record
from .summary import grade, most_telling


def document(record: Record) -> str:
    """Returns the page: verdicts, then the vectors. Failures come first, the most telling ones at the top."""
    order = {status: i for i, status in enumerate(STATUSES)}
    failed = most_telling(record.vectors)
    rank = {v.id: i for i, v in enumerate(failed)}
    vectors = sorted(record.vectors, key=lambda v: (order[v.status], rank.get(v.id, 0)))
    holes = [(name, row) for name, row in record.requirements.items() if row.right < row.run]
    features = [row.right == row.run for row in record.features.values() if row.run]
    return render(
        Path(__file__).with_name("page.html"),
        r=record,
        about=to_builtins(record.decoder.description),
        vectors=vectors,
        bad=len(failed),
        grade=grade(record),
        requirements=sum(row.run > 0 for row in record.requirements.values()),
        features=features,
        statuses=STATUSES,
        holes=holes,
    )
