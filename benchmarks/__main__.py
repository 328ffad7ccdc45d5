"""Measurements of speed and scale: python -m benchmarks decode|scale [--json] [--write]

By default it prints a table. --json prints all figures instead. --write also writes the section of RESULTS.md.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from refcodec.bitstream.errors import BitstreamError
from refcodec.files.text import printable
from refcodec.statuses import DONE, FAULT, USAGE

from .coding import coding, coding_lines
from .contenders import DisagreementError
from .large import KEPT, PAPER_ANCHORS, TRAINED
from .results import write_section
from .scale import SIZES, scale, scale_lines, write_plot

TITLES = {
    "decode": "Decoding a large scene",
    "scale": "Time and memory by the number of anchors",
}


def _positive(word: str) -> int:
    value = int(word)
    if value < 1:
        raise ValueError
    return value


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    tasks = parser.add_subparsers(dest="task", required=True)
    each = {}
    for task, text in (
        ("decode", "each path of refcodec, the C decoder, constriction and the floor"),
        ("scale", "whole and streaming decoding, by the number of anchors"),
    ):
        each[task] = tasks.add_parser(task, help=text, description=text)
        each[task].add_argument("--json", action="store_true", help="print all figures as JSON")
        each[task].add_argument("--write", action="store_true", help="write the section of benchmarks/RESULTS.md")
        each[task].add_argument("--trained", type=Path, default=TRAINED, help="the scene whose symbols are coded")
    each["decode"].add_argument("--anchors", type=_positive, default=PAPER_ANCHORS)
    each["decode"].add_argument("--rounds", type=_positive, default=7)
    each["scale"].add_argument("--sizes", type=_positive, nargs="+", default=list(SIZES), metavar="ANCHORS")
    each["scale"].add_argument("--rounds", type=_positive, default=3)
    return parser


def _figures(options: argparse.Namespace, kept: Path) -> tuple[dict[str, Any], list[str]]:
    """Returns the figures of a task, and the lines of its section."""
    if options.task == "scale":
        figures = scale(options.trained, options.sizes, options.rounds, kept)
        return figures, scale_lines(figures)
    figures = coding(options.trained, options.anchors, options.rounds, kept)
    return figures, coding_lines(figures)


def main(words: list[str] | None = None, kept: Path = KEPT) -> int:
    """Measures and prints. Returns the exit status. kept: the folder of large scenes."""
    words = sys.argv[1:] if words is None else words
    options = _parser().parse_args(words)
    try:
        figures, lines = _figures(options, kept)
    except DisagreementError as error:
        print(error, file=sys.stderr)
        return FAULT
    except (OSError, BitstreamError) as error:
        print(printable(str(error)), file=sys.stderr)
        return USAGE
    print(json.dumps(figures, indent=1) if options.json else "\n".join(lines))
    if options.write:
        if options.task == "scale":
            write_plot(figures)
        shown = " ".join(word for word in words if word not in ("--json", "--write"))
        write_section(
            options.task,
            TITLES[options.task],
            [f"`python -m benchmarks {shown}`", "", *lines],
        )
    return DONE


if __name__ == "__main__":
    sys.exit(main())
