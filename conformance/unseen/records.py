"""The runner's record of each wrong decoder, kept in a folder: what is there is not run again."""

from __future__ import annotations

import datetime
import hashlib
import json
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from refcodec.files.documents import read_json
from refcodec.files.stage import write_file

from ..manifest import Accepted, Manifest, Vector
from ..report import record as records
from ..runner import divergence, grading
from ..runner.run import Options, Result, Run, shown
from ..runner.selection import select
from .bugs import SOURCES, Wrong
from .making import Decoder, made

# The quick part of the suite: small scenes, and files whose header nobody can read, up to so many bytes.
SELECT = "!class:resource operation:decode profile:tiny,none"
QUICK_BYTES = 24000
# The statuses of a vector that a decoder fails.
FAILED = ("failed", "crashed")
_DESCRIPTION = {"name": "decoder", "version": records.NOT_STATED}


@dataclass(frozen=True)
class Kept:
    """Where records are. folder: theirs. manifest: the suite's."""

    folder: Path
    manifest: Manifest

    def path(self, wrong: Wrong) -> Path:
        """The file of a record. Its name changes with the suite, the decoders, the bugs and the form of records."""
        said = [
            records.manifest_digest(self.manifest),
            f"{SELECT} {QUICK_BYTES}",
            _sources(),
            json.dumps(wrong.texts(), sort_keys=True),
        ]
        return self.folder / f"{wrong.id}-{hashlib.sha256(chr(10).join(said).encode()).hexdigest()[:12]}.json"

    def read(self, wrong: Wrong) -> dict[str, Any] | None:
        """A record, or None if there is none. Raises OSError and DocumentError."""
        path = self.path(wrong)
        if not path.exists():
            return None
        found: dict[str, Any] = read_json(path)
        return found

    def make(self, wrong: Wrong) -> dict[str, Any]:
        """Runs a wrong decoder on the quick part of the suite, and keeps the record.

        It is the record that the runner makes, but for the annotated bytes. Nothing in it names the bug, so a diagnosis
        may have all of it. Raises what `making.made` raises.
        """
        vectors = [v for v in select(self.manifest.vectors, [SELECT]) if v.input.size <= QUICK_BYTES]
        started, began = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"), time.monotonic()
        with tempfile.TemporaryDirectory() as place:
            folder, output = Path(place) / "decoder", Path(place) / "output"
            folder.mkdir()
            with made(wrong, folder) as decoder:
                results = [self._result(decoder, vector, output) for vector in vectors]
        about = records.About(_DESCRIPTION, (SELECT,), started, time.monotonic() - began)
        record = records.build(self.manifest, Options(decoder.command), about, Run(results))
        write_file(self.path(wrong), (json.dumps(record, indent=1) + "\n").encode())
        return record

    def _result(self, decoder: Decoder, vector: Vector, output: Path) -> Result:
        output.unlink(missing_ok=True)
        ended = decoder.run(self.manifest.path(vector), output, vector.budget.seconds, vector.budget.bytes)
        found = grading.read(ended, output)
        judgement = grading.judge(self.manifest, vector, found, output)
        lines: tuple[str, ...] = ()
        if judgement.text and found.result == "accepted" and isinstance(vector.expectation, Accepted):
            differs = divergence.of_output(self.manifest.path(vector).read_bytes(), output.read_bytes())
            lines = (differs.text(),) if differs else ()
        status = "passed" if judgement.grade == grading.GRADE_EXACT else "failed"
        status = "crashed" if found.result == "crashed" else status
        stderr = shown(ended.stderr)
        return Result(vector, status, judgement.grade, judgement.text, found, lines, (), stderr, ended.seconds)


@cache
def _sources() -> str:
    """A digest of the right decoders and of the schema of records."""
    files = [*(path for folder in SOURCES.values() for path in folder.glob("*.[cp]*")), records.SCHEMA]
    digest = hashlib.sha256()
    for path in sorted(path for path in files if path.is_file()):
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def failing(record: dict[str, Any]) -> dict[str, str]:
    """The vectors that a decoder fails, each with what it made of it, as a text."""
    return {v["id"]: json.dumps(v["found"], sort_keys=True) for v in record["vectors"] if v["status"] in FAILED}


def collect(kept: Kept, wrong: Sequence[Wrong], jobs: int) -> Iterator[tuple[Wrong, dict[str, Any], bool]]:
    """The record of each wrong decoder, and whether it was made now. jobs: so many are made at a time."""

    def one(wrong: Wrong) -> tuple[Wrong, dict[str, Any], bool]:
        record = kept.read(wrong)
        return wrong, record or kept.make(wrong), record is None

    # What runs is ended by Ctrl-C, and what waits is not begun.
    with ThreadPoolExecutor(jobs) as pool:
        try:
            yield from pool.map(one, wrong)
        finally:
            pool.shutdown(cancel_futures=True)
