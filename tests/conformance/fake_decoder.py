"""A decoder that knows the answers of a few files, and goes wrong in the way that its first argument says.

fake_decoder.py MODE ANSWERS INPUT OUTPUT [TRACE]; ANSWERS: JSON of SHA-256 -> {"exit": 0, "output": path, "trace":
path, "extended": bool} or {"exit": 1 or 2, "code", "offset"}. Standard library alone, so that it starts fast.
"""

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path


def refuse(status, code, offset, **more):
    print("this file is refused", file=sys.stderr)
    print(json.dumps({"code": code, "offset": offset, **more}), file=sys.stderr)
    return status


def right(answer, output, trace):
    if answer["exit"]:
        return refuse(answer["exit"], answer["code"], answer["offset"])
    output.write_bytes(Path(answer["output"]).read_bytes())
    if trace:
        trace.write_bytes(Path(answer["trace"]).read_bytes())
    return 0


def answer(answers, name):
    return json.loads(Path(answers).read_text())[hashlib.sha256(Path(name).read_bytes()).hexdigest()]


def main(mode, answers, name, target, *rest):
    known = answer(answers, name)
    output, trace = Path(target), Path(rest[0]) if rest else None
    good = known["exit"] == 0
    match mode:
        case "raises":
            raise RuntimeError("planted")
        case "nothing":
            return 0
        case "accepts":
            output.write_bytes(b"C3GSREC1")
            return 0
        case "rejects":
            return refuse(1, 103, 16)
        case "segfault":
            os.kill(os.getpid(), signal.SIGSEGV)
        case "segfault-after-json":
            refuse(1, known.get("code", 103), known.get("offset", 16))
            os.kill(os.getpid(), signal.SIGSEGV)
        case "hang":
            time.sleep(600)
        case "spins":
            while True:
                pass
        case "hang-in-child":
            subprocess.run(["sleep", "600"], check=False)
        case "memory":
            held = []
            while True:
                held.append(bytes(8 << 20) + b"x")
        case "memory-in-child":
            subprocess.run([sys.executable, "-S", __file__, "memory", answers, name, target], check=False)
            return right(known, output, trace)
        case "json-exit-0" if not good:
            refuse(0, known["code"], known["offset"])
            return 0
        case "right-exit-1" if good:
            right(known, output, trace)
            return 1
        case "json-and-output" if good:
            right(known, output, trace)
            return refuse(1, 103, 16)
        case "exit-3" if not good:
            return refuse(3, known["code"], known["offset"])
        case "giant":
            with output.open("wb") as file:
                while True:
                    file.write(bytes(1 << 20))
        case "giant-sparse":
            with output.open("wb") as file:
                file.truncate(1 << 40)
            return 0
        case "floods-stderr":
            while True:
                sys.stderr.write("x" * (1 << 20))
        case "talks-much":
            sys.stderr.write("a line of talk\n" * 50_000)
            print("and much on stdout " * 100_000)
            return right(known, output, trace)
        case "no-ancillary" if good and known["extended"]:
            return refuse(2, 302, 216)
        case "unregistered" if not good:
            return refuse(known["exit"], 999, known["offset"])
        case "code-as-text" if not good:
            return refuse(known["exit"], str(known["code"]), known["offset"])
        case "code-true" if not good:
            return refuse(known["exit"], True, known["offset"])
        case "json-then-text" if not good:
            refuse(known["exit"], known["code"], known["offset"])
            print("the end", file=sys.stderr)
            return known["exit"]
        case "json-list" if not good:
            print(json.dumps([known["code"], known["offset"]]), file=sys.stderr)
            return known["exit"]
        case "json-deep" if not good:
            print("[" * 10_000, file=sys.stderr)
            return known["exit"]
        case "no-offset" if not good:
            print(json.dumps({"code": known["code"]}), file=sys.stderr)
            return known["exit"]
        case "offset-1" if not good:
            return refuse(known["exit"], known["code"], known["offset"] + 1)
        case "other-code" if not good:
            same = {"malformed": 103, "invalid": 212, "unsupported": 205}
            return refuse(known["exit"], same[known["class"]], known["offset"])
        case "always-exit-1" if not good:
            return refuse(1, known["code"], known["offset"])
        case "last-bit" | "first-bit" | "digest-bit" | "short" | "long" if good:
            data = bytearray(Path(known["output"]).read_bytes())
            data[{"last-bit": -1, "digest-bit": 251}.get(mode, 0)] ^= mode.endswith("bit")
            output.write_bytes({"short": data[:-1], "long": data + b"\0"}.get(mode, data))
            return 0
        case "wrong-trace" if good and trace:
            right(known, output, trace)
            trace.write_text(trace.read_text().replace(" ", "  ", 1))
            return 0
        case "no-trace" if good:
            return right(known, output, None)
        case "leaves-child":
            subprocess.Popen(["sleep", "600"])
            return right(known, output, trace)
        case "changes-input":
            Path(name).chmod(0o600)
            Path(name).write_bytes(b"")
        case "changes-suite":
            Path(os.environ["FAKE_DECODER_CHANGES"]).write_bytes(b"")
    return right(known, output, trace)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
