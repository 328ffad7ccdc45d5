"""The benchmarks: each measures, prints a section of RESULTS.md, and writes it with --write.

python -m benchmarks NAME --help     what one measures, and its options
"""

import argparse
import sys
from importlib import import_module

from refcodec.files.text import printable
from refcodec.statuses import USAGE

from .results import publish

# By the name of the section: its module, which has the OPTIONS, the function that returns the lines, and its title.
BENCHMARKS = {
    "decode": ("decoders", "decode", "Decoding a large scene"),
    "peers-speed": ("peers.speed", "section", "Decoding time beside SPZ"),
    "exports": ("exports", "section", "Exported scenes"),
    "converted": ("converted", "section", "Converted splat files"),
    "worst": ("worst", "section", "The worst files of each step"),
    "gpu": ("gpu", "section", "Training on a GPU beside the CPU"),
}


def _parser(name: str, about: str | None) -> argparse.ArgumentParser:
    return argparse.ArgumentParser(
        prog=f"python -m {name}", description=about, formatter_class=argparse.RawDescriptionHelpFormatter
    )


def main(words: list[str] | None = None) -> int:
    """Runs a benchmark. Returns the exit status: 64 if it cannot be run."""
    words = sys.argv[1:] if words is None else words
    front = _parser("benchmarks", __doc__)
    front.add_argument("name", choices=BENCHMARKS)
    name = front.parse_args(words[:1]).name
    module, function, title = BENCHMARKS[name]
    # Other benchmarks need other packages.
    benchmark = import_module(f"benchmarks.{module}")
    parser = _parser(f"benchmarks {name}", benchmark.__doc__)
    for option, settings in benchmark.OPTIONS.items():
        parser.add_argument(option, **settings)
    parser.add_argument("--write", action="store_true", help="write the section of benchmarks/RESULTS.md")
    options = parser.parse_args(words[1:])
    try:
        lines = getattr(benchmark, function)(options)
    except (ValueError, OSError) as error:
        print(printable(str(error), lines=True), file=sys.stderr)
        return USAGE
    return publish(name, title, lines, options.write)


if __name__ == "__main__":
    sys.exit(main())
