"""A decoder that knows the answers of a few files, and misbehaves as a mode says.

fake_decoder.py MODE ANSWERS INPUT OUTPUT [TRACE], or fake_decoder.py MODE ANSWERS as a server. ANSWERS: JSON of
SHA-256 -> {"mode", "exit": 0, "output": path, "trace": path, "extended": bool} or {"mode", "exit": 1 or 2, "code",
"offset", "class"}. With the mode "listed" each file has the mode of its answer. Every attack is bounded, so that it
does little harm if the runner does not stop it. Only the standard library is imported, for a fast start.
"""

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

# Seconds after which a process ends that a decoder leaves behind.
LINGERS = 30
NAP = ["sleep", f"{LINGERS}"]
STEERS = (
    b"\x1b[31m \x1b]0;title\x07 \x9b31m \x00 \xc2\x9b31m \xe2\x80\xae\xd9\x84 \xff\xfe \xed\xa0\x80 </pre><script>\n"
    b"\x1b]52;c;aGk=\x07 a last line that is not JSON\r\x08\x7f"
)
# A refusal with another code of the same class.
OTHERS = {"malformed": 103, "invalid": 212, "unsupported": 205}


def refuse(status, code, offset):
    print("this file is refused", file=sys.stderr)
    print(json.dumps({"code": code, "offset": offset}), file=sys.stderr, flush=True)
    return status


def right(answer, output, trace):
    if answer["exit"]:
        return refuse(answer["exit"], answer["code"], answer["offset"])
    output.write_bytes(Path(answer["output"]).read_bytes())
    if trace:
        trace.write_bytes(Path(answer["trace"]).read_bytes())
    return 0


def linger():
    time.sleep(LINGERS)


def spin():
    while True:
        pass


def eat():
    held = []
    while len(held) < 100:
        held.append(bytes(8 << 20) + b"x")
    linger()


def flood(number):
    while True:
        os.write(number, b"x" * (1 << 20))


def dig():
    """Makes folders in one another, beyond Python's recursion and the longest path; the last is closed, but to root."""
    os.chdir(os.environ["TMPDIR"])
    for _ in range(1500):
        os.mkdir("deep")
        os.chdir("deep")
    os.makedirs("closed/within")
    os.chmod("closed", 0)


def giant(output):
    with output.open("wb") as file:
        while True:
            file.write(bytes(1 << 20))


def main(mode, answers, name, target, *rest):
    source, output, trace = Path(name), Path(target), Path(rest[0]) if rest else None
    known = json.loads(Path(answers).read_text())[hashlib.sha256(source.read_bytes()).hexdigest()]
    mode, good = known["mode"] if mode == "listed" else mode, known["exit"] == 0
    # What a decoder does that ends otherwise, by mode.
    misuse = {
        "hang": linger,
        "hang-in-child": lambda: subprocess.run(NAP, check=False),
        "spins": spin,
        "segfault": lambda: os.kill(os.getpid(), signal.SIGSEGV),
        "memory": eat,
        "much-on-stderr": lambda: flood(2),
        "output-is-giant": lambda: giant(output),
        "output-is-a-link": lambda: output.symlink_to("/dev/zero"),
        "nothing": lambda: None,
    }
    if mode in misuse:
        misuse[mode]()
        return 0
    if mode == "deep-folders":
        dig()
    if mode == "left-children":
        subprocess.Popen(NAP)
    if mode == "changes-suite":
        Path(os.environ["FAKE_DECODER_CHANGES"]).write_bytes(b"")
    match mode:
        case "raises":
            raise RuntimeError("planted")
        case "accepts":
            output.write_bytes(b"C3GSREC1")
            return 0
        case "rejects":
            return refuse(1, 103, 16)
        case "text-that-steers":
            os.write(2, STEERS)
            return 1
        case "no-ancillary" if good and known["extended"]:
            return refuse(2, 302, 216)
        case "last-bit" | "first-bit" | "digest-bit" | "short" | "long" if good:
            data = bytearray(Path(known["output"]).read_bytes())
            data[{"last-bit": -1, "digest-bit": 283}.get(mode, 0)] ^= mode.endswith("bit")
            output.write_bytes({"short": data[:-1], "long": data + b"\0"}.get(mode, data))
            return 0
        case "wrong-trace" if good and trace:
            right(known, output, trace)
            trace.write_text(trace.read_text().replace(" ", "  ", 1))
            return 0
        case "no-trace" if good:
            return right(known, output, None)
        case "exit-1" if not good:
            return refuse(1, known["code"], known["offset"])
        case "offset-1" if not good:
            return refuse(known["exit"], known["code"], known["offset"] + 1)
        case "other-code" if not good:
            return refuse(known["exit"], OTHERS[known["class"]], known["offset"])
    return right(known, output, trace)


def serve(answers):
    """Answers requests. What a mode does not replace is right."""
    known = json.loads(Path(answers).read_text())
    for line in sys.stdin:
        q = json.loads(line)
        a = known[hashlib.sha256(Path(q["input"]).read_bytes()).hexdigest()]
        answer, output = {"id": q["id"], "status": a["exit"]}, Path(q["output"])
        if a["exit"]:
            answer["stderr"] = json.dumps({"code": a["code"], "offset": a["offset"]})
        else:
            output.write_bytes(Path(a["output"]).read_bytes())
        more = {"signal": {"status": None, "signal": 11}, "both": {"signal": 11}, "of-another": {"id": q["id"] + 1}}
        text = json.dumps(answer | more.get(a["mode"], {}))
        match a["mode"]:
            case "deep-folders":
                dig()
            case "much-on-stderr":
                flood(2)
            case "left-children":
                subprocess.Popen(NAP)
            case "dies":
                os.abort()
            case "eats":
                eat()
            case "late":
                subprocess.run(NAP, check=False)
            case "garbage":
                text = "accepted"
            case "endless":
                text = " " * (1 << 22) + text
            case "twice":
                text += "\n" + text
        print(text, flush=True)


if __name__ == "__main__":
    if len(sys.argv) == 3:
        serve(sys.argv[2])
    else:
        sys.exit(main(*sys.argv[1:]))
