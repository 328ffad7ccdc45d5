"""The command line: validate, digest and decode."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

from . import C3GSError, decode
from .watch import watched

USAGE = (
    "usage: python -m conformance.spec_decoder "
    "validate FILE | digest FILE [--parts] | decode FILE OUTPUT [--trace TRACE [--probes]]"
)
REJECTED, UNSUPPORTED, USAGE_ERROR = 1, 2, 64


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
        if trace:
            with open(trace, "w", encoding="utf-8", newline="\n") as file, watched(file, probed):
                decoded = decode(data)
        else:
            decoded = decode(data)
        if command == "decode":
            Path(output).write_bytes(decoded.reconstruction)
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
