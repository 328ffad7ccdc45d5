"""The command line: validate, digest and decode."""

import io
import json
import os
import sys
from contextlib import nullcontext
from pathlib import Path

from . import C3GSError, decode
from .watch import watched

USAGE = (
    "usage: python -m conformance.spec_decoder "
    "validate FILE | digest FILE [--parts] | decode FILE OUTPUT [--trace TRACE [--probes]]"
)
REJECTED, UNSUPPORTED, USAGE_ERROR = 1, 2, 64


def _write(name: str, data: bytes) -> None:
    """Writes a file beside its place, and moves it there. A pipe or a device is written to. Raises OSError."""
    place = beside = Path(os.path.realpath(name))
    if place.is_file() or not place.exists():
        beside = place.with_name(f".spec-decoder-{os.getpid()}")
    try:
        beside.write_bytes(data)
        os.replace(beside, place)
    except OSError as error:
        if beside != place:
            beside.unlink(missing_ok=True)
        raise OSError(error.errno, error.strerror, name) from None


# SPEC 10.2: a refusal is reported, on stderr and by the exit status as conformance/README.md has it
def main(arguments: list[str]) -> int:
    """Runs a command and returns its exit status."""
    output = trace = ""
    probed = False
    match arguments:
        case ["validate" | "digest" as command, path]:
            parts = False
        case ["digest" as command, path, "--parts"] | ["digest" as command, "--parts", path]:
            parts = True
        case ["decode" as command, path, output]:
            parts = False
        case ["decode" as command, path, output, "--trace", trace]:
            parts = False
        case ["decode" as command, path, output, "--trace", trace, "--probes"]:
            parts, probed = False, True
        case _:
            print(USAGE, file=sys.stderr)
            return USAGE_ERROR
    places = [os.path.realpath(place) for place in (path, output, trace) if place]
    try:
        data = Path(path).read_bytes()
        if len(set(places)) < len(places) or any(os.path.isfile(p) and os.path.samefile(path, p) for p in places[1:]):
            print("an output is the input, or another output", file=sys.stderr)
            return USAGE_ERROR
        lines = io.StringIO()
        try:
            with watched(lines, probed) if trace else nullcontext():
                decoded = decode(data)
        finally:
            if lines.tell():
                _write(trace, lines.getvalue().encode())
        if command == "decode":
            _write(output, decoded.reconstruction)
    except C3GSError as error:
        print(error, file=sys.stderr)
        print(json.dumps(error.as_dict()), file=sys.stderr)
        return UNSUPPORTED if error.kind == "unsupported" else REJECTED
    except OSError as error:
        print(error, file=sys.stderr)
        return USAGE_ERROR
    if command == "digest":
        for name, value in decoded.digests.items():
            if parts or name == "whole":
                print(f"{name}  {value}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
