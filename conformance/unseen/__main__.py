"""python -m conformance.unseen: the wrong decoders run, pairs drawn, a diagnosis judged."""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from refcodec import statuses
from refcodec.files.documents import DocumentError
from refcodec.statuses import UsageError

from ..cli.errors import note, status_of
from ..cli.shared import add_vectors, positive, suite
from . import drawing, judging
from .bugs import BugError, Wrong, bugs, decoders
from .records import Kept, collect, failing

SEED = 18


def _chosen(names: Sequence[str]) -> list[Wrong]:
    """The wrong decoders of these names, all if there is none. Raises UsageError."""
    known = {wrong.id: wrong for wrong in decoders()}
    strangers = sorted(set(names) - set(known))
    if strangers:
        raise UsageError(f"there is no bug {', '.join(strangers)}")
    return [known[name] for name in names] or list(known.values())


def _run(arguments: argparse.Namespace) -> int:
    kept, passed = Kept(arguments.records, suite(arguments.vectors)), []
    for wrong, record, new in collect(kept, _chosen(arguments.bugs), arguments.jobs):
        count = len(failing(record))
        passed += [wrong.id] * (count == 0)
        took = f", {record['runner']['seconds']:.1f} s" if new else ""
        print(f"{wrong.id}: {count} of {len(record['vectors'])} vectors fail{took}", flush=True)
    for name in passed:
        note(f"no vector catches {name}")
    return statuses.REJECTED if passed else statuses.DONE


def _records(arguments: argparse.Namespace, chosen: Sequence[Wrong]) -> list[tuple[Wrong, dict[str, Any]]]:
    """The records of wrong decoders. Raises UsageError for one that was not run."""
    kept, found = Kept(arguments.records, suite(arguments.vectors)), []
    for wrong in chosen:
        record = kept.read(wrong)
        if record is None:
            raise UsageError(f"{wrong.id} was not run on these vectors: python -m conformance.unseen run")
        found.append((wrong, record))
    return found


def _draw(arguments: argparse.Namespace) -> int:
    single = [Wrong((bug,)) for bug in bugs() if bug.decoder == "independent"]
    drawn = drawing.draw(_records(arguments, single), arguments.seed)
    drawing.write(drawn, arguments.seed)
    print(f"{len(drawn)} pairs, {sum(pair.hides for pair in drawn)} with one that hides the other")
    return statuses.DONE


def _diagnosis(place: str) -> judging.Diagnosis:
    """The function of a place, MODULE:FUNCTION. Raises UsageError."""
    module, _, name = place.partition(":")
    try:
        found: judging.Diagnosis = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise UsageError(f"{place}: {error}") from None
    return found


def _judge(arguments: argparse.Namespace) -> int:
    diagnosis = _diagnosis(arguments.diagnosis)
    for line in judging.table(judging.judged(_records(arguments, _chosen(arguments.bugs)), diagnosis)):
        print(line)
    return statuses.DONE


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m conformance.unseen", description="Wrong decoders that no diagnosis has seen."
    )
    commands = parser.add_subparsers(required=True, metavar="command")

    def command(name: str, text: str) -> argparse.ArgumentParser:
        found: argparse.ArgumentParser = commands.add_parser(name, help=text, description=text)
        add_vectors(found)
        found.add_argument(
            "--records", type=Path, default=Path("out/unseen"), metavar="DIR", help="where records are (out/unseen)"
        )
        return found

    found = command("run", "run the wrong decoders on the quick vectors, and keep the record of each that has none")
    found.add_argument("--jobs", type=positive, default=1, metavar="N", help="decoders at a time (default 1)")
    found.add_argument("bugs", nargs="*", metavar="BUG", help="these alone")
    found.set_defaults(run=_run)
    found = command("draw", "draw the pairs anew, from the records of the single bugs")
    found.add_argument("--seed", type=int, default=SEED, help=f"of the draw (default {SEED})")
    found.set_defaults(run=_draw)
    found = command("judge", "ask a diagnosis about each record, and print how often it is right")
    found.add_argument(
        "--diagnosis",
        default="conformance.unseen.judging:told",
        metavar="MODULE:FUNCTION",
        help="takes a record, returns clauses with whether it stands by each (default: what the record tells)",
    )
    found.add_argument("bugs", nargs="*", metavar="BUG", help="these alone")
    found.set_defaults(run=_judge)
    return parser


def main(argv: list[str] | None = None) -> int:
    """Runs a command; returns its exit status, one of refcodec/statuses.py."""
    try:
        arguments = _parser().parse_args(argv)
        status: int = arguments.run(arguments)
    except SystemExit as end:
        # argparse has a status of its own for wrong usage.
        return statuses.USAGE if end.code else statuses.DONE
    except KeyboardInterrupt:
        note("interrupted")
        return statuses.INTERRUPTED
    except Exception as error:
        known = statuses.USAGE if isinstance(error, BugError | DocumentError) else status_of(error)
        if known is None:
            raise
        note(str(error))
        return known
    return status


if __name__ == "__main__":
    sys.exit(main())
