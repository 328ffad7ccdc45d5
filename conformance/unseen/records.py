"""The runner's record of each wrong decoder, kept in a folder: what is there is not run again."""

from __future__ import annotations

import datetime
import hashlib
import json
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from refcodec.files.documents import read_json
from refcodec.files.stage import write_file

from ..manifest import Manifest
from ..report import record as records
from ..runner.run import Options, run
from ..runner.selection import select
from .bugs import SOURCES, Wrong
from .making import make

# The quick part of the suite: the small files, and those whose header nobody can read.
SELECT = "!class:resource operation:decode profile:tiny,none"
# Factor of the time budgets, so that a busy machine gives the same records as an idle one.
SLOW = 4.0
# The statuses of a vector that a decoder fails.
FAILED = ("failed", "crashed")


class InterruptedRunError(Exception):
    """A run was ended from outside, and its record is not kept."""


@dataclass(frozen=True)
class Kept:
    """Where records are. folder: theirs. manifest: the suite's."""

    folder: Path
    manifest: Manifest

    def path(self, wrong: Wrong) -> Path:
        """The file of a record. Its name changes with the suite, the decoders, the bugs and the form of records."""
        said = [records.manifest_digest(self.manifest), SELECT, _sources(), json.dumps(wrong.texts(), sort_keys=True)]
        return self.folder / f"{wrong.id}-{hashlib.sha256(chr(10).join(said).encode()).hexdigest()[:12]}.json"

    def read(self, wrong: Wrong) -> dict[str, Any] | None:
        """A record, or None if there is none. Raises OSError and DocumentError."""
        path = self.path(wrong)
        if not path.exists():
            return None
        found: dict[str, Any] = read_json(path)
        return found

    def make(self, wrong: Wrong, jobs: int) -> dict[str, Any]:
        """Runs a wrong decoder on the quick part of the suite, and keeps the record.

        Nothing in the record names the bug, so that a diagnosis may have all of it.
        Raises InterruptedRunError, and what `making.make` raises.
        """
        vectors = select(self.manifest.vectors, [SELECT])
        started, began = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"), time.monotonic()
        with tempfile.TemporaryDirectory(prefix="decoder-") as folder:
            made = make(wrong, Path(folder))
            options = Options(made.command, jobs=jobs, slow=SLOW, serve=made.serve)
            done = run(self.manifest, vectors, options, show=False)
        if done.interrupted:
            raise InterruptedRunError
        description = {"name": "decoder", "version": records.NOT_STATED}
        about = records.About(description, (SELECT,), started, time.monotonic() - began)
        record = records.build(self.manifest, options, about, done)
        write_file(self.path(wrong), (json.dumps(record, indent=1) + "\n").encode())
        return record


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
    """The record of each wrong decoder, and whether it was made now."""
    for one in wrong:
        record = kept.read(one)
        yield one, record or kept.make(one, jobs), record is None
