"""The command line: validate, digest and decode."""

import json
import os
import sys
from contextlib import nullcontext
from pathlib import Path

from .codec import decode
from .errors import C3GSError
from .probes import probes
from .reconstruction import canonical_parts, digested, digests
from .trace import Trace

USAGE = (
    "usage: python -m conformance.independent "
    "validate FILE | digest FILE [--parts] | decode FILE OUTPUT [--trace TRACE [--probes]]"
)
REJECTED, UNSUPPORTED, USAGE_ERROR = 1, 2, 64


# SPEC 10.2: a refusal is reported on stderr and by the exit status
def main(arguments: list[str]) -> int:
    """Run a command and return its exit status."""
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
            with open(trace, "w", encoding="utf-8", newline="\n") as file, probes(file) if probed else nullcontext():
                scene = decode(data, Trace(file))
        else:
            scene = decode(data)
        if command == "decode":
            canonical = canonical_parts(scene)
            Path(output).write_bytes(digested(scene, canonical) + b"".join(canonical.values()))
    except C3GSError as error:
        print(error, file=sys.stderr)
        print(json.dumps(error.as_dict()), file=sys.stderr)
        return UNSUPPORTED if error.kind == "unsupported" else REJECTED
    except OSError as error:
        print(error, file=sys.stderr)
        return USAGE_ERROR
    if command == "digest":
        for name, value in digests(scene).items():
            if parts or name == "whole":
                print(f"{name}  {value}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
