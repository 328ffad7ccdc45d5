"""Decodes file after file in one process: what a wrong decoder's process would have said of each.

python -m conformance.unseen.child

It is started where `conformance.independent` is a wrong decoder. It reads lines of JSON from stdin, {"input", "output",
"seconds", "bytes"}, and answers each with {"status", "stderr"}. A file that takes too much time ends it by SIGPROF.
"""

from __future__ import annotations

import contextlib
import io
import json
import resource
import signal
import sys

from refcodec import statuses

from ..independent.__main__ import main as decode

# What the interpreter has taken before a file is looked at, in bytes of address space.
_INTERPRETER_BYTES = 128 << 20


def answers() -> None:
    """Answers until stdin ends."""
    signal.signal(signal.SIGPROF, signal.SIG_DFL)
    answer_to = sys.stdout
    for line in sys.stdin:
        request, errors, status = json.loads(line), io.StringIO(), statuses.FAULT
        signal.setitimer(signal.ITIMER_PROF, request["seconds"])
        resource.setrlimit(resource.RLIMIT_AS, (request["bytes"] + _INTERPRETER_BYTES, resource.RLIM_INFINITY))
        # Whatever it raises is a crash, and the next file is asked for all the same.
        with contextlib.suppress(Exception), contextlib.redirect_stderr(errors), contextlib.redirect_stdout(errors):
            status = decode(["decode", request["input"], request["output"]])
        signal.setitimer(signal.ITIMER_PROF, 0)
        print(json.dumps({"status": status, "stderr": errors.getvalue()}), file=answer_to, flush=True)


if __name__ == "__main__":
    answers()
