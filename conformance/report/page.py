"""The record as one HTML page that loads no other files."""

from pathlib import Path

from msgspec import to_builtins

from refcodec.pages.environment import render

from ..runner.grading import GRADES
from ..runner.run import STATUSES
from .schema import Record
from .summary import most_telling


def document(record: Record) -> str:
    """Returns the page: verdicts, then the vectors. Failures come first, the most telling ones at the top."""
    order = {status: i for i, status in enumerate(STATUSES)}
    failed = most_telling(record.vectors)
    rank = {v.id: i for i, v in enumerate(failed)}
    vectors = sorted(record.vectors, key=lambda v: (order[v.status], rank.get(v.id, 0)))
    holes = [(name, row) for name, row in record.requirements.items() if row.right < row.vectors]
    right_features = sum(row.right == row.vectors for row in record.features.values())
    return render(
        Path(__file__).with_name("page.html"),
        r=record,
        about=to_builtins(record.decoder.description),
        vectors=vectors,
        bad=len(failed),
        grades=GRADES,
        best=max(GRADES),
        statuses=STATUSES,
        holes=holes,
        right_features=right_features,
    )
