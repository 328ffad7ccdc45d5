"""Serves one of the project's decoders to `conformance run --serve`, which imports its modules once.

python -m conformance.runner.serve refcodec | spec_decoder

Reads lines of JSON, {"id", "input", "output"} and optionally "trace". Answers each with {"id", "status", "signal",
"stderr"}. A fork decodes each file. Thus no file affects the next one.
"""

import contextlib
import json
import os
import sys
import tempfile
from collections.abc import Callable
from typing import Any

from refcodec import statuses

# The bytes of a fork's error output in an answer, from its end.
_STDERR_BYTES = 16 << 10


def _refcodec() -> Callable[[list[str]], int]:
    # Imports and tables before the first fork serve all forks.
    from refcodec.bitstream import codec, networks, reconstruction, tables  # noqa: F401, PLC0415
    from refcodec.cli import main as cli  # noqa: PLC0415
    from refcodec.inspect import trace  # noqa: F401, PLC0415

    networks.float32_is_exact()
    tables.tables()
    return lambda words: cli.main(["reconstruct", *words])


def _spec_decoder() -> Callable[[list[str]], int]:
    from ..spec_decoder.__main__ import main  # noqa: PLC0415

    return lambda words: main(["decode", *words])


DECODERS = {"refcodec": _refcodec, "spec_decoder": _spec_decoder}


def _in_fork(decode: Callable[[list[str]], int], words: list[str]) -> dict[str, Any]:
    with tempfile.TemporaryFile() as errors:
        pid = os.fork()
        if pid == 0:
            status = statuses.FAULT
            with contextlib.suppress(BaseException):
                os.dup2(errors.fileno(), 2)
                status = decode(words)
            sys.stderr.flush()
            os._exit(status)
        code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        errors.seek(max(0, errors.seek(0, os.SEEK_END) - _STDERR_BYTES))
        text = errors.read().decode("utf-8", "replace")
    return {"status": code if code >= 0 else None, "signal": -code if code < 0 else None, "stderr": text}


def main(arguments: list[str]) -> int:
    """Answers until stdin ends; returns the exit status."""
    if len(arguments) != 1 or arguments[0] not in DECODERS:
        print(f"usage: python -m conformance.runner.serve {' | '.join(DECODERS)}", file=sys.stderr)
        return statuses.USAGE
    decode = DECODERS[arguments[0]]()
    for line in sys.stdin:
        try:
            request = json.loads(line)
            words = [request["input"], request["output"]]
            words += ["--trace", request["trace"]] if "trace" in request else []
            answer = {"id": request["id"]}
        except (ValueError, LookupError, TypeError):
            print('a request is a JSON line {"id", "input", "output"}, optionally with "trace"', file=sys.stderr)
            return statuses.USAGE
        print(json.dumps({**answer, **_in_fork(decode, words)}), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
