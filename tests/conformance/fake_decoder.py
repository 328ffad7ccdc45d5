"""A decoder that knows the answers of a few files, and fails in the way that a mode says.

fake_decoder.py MODE ANSWERS INPUT OUTPUT [TRACE], or fake_decoder.py MODE ANSWERS as a server. ANSWERS: JSON of
SHA-256 -> {"mode", "exit": 0, "output": path, "trace": path, "extended": bool} or {"mode", "exit": 1 or 2, "code",
"offset", "class"}. With the mode "listed" each file has the mode of its answer. Every attack is bounded, so that it
does little harm if the runner does not stop it. Only the standard library is imported, for a fast start.
"""

import contextlib
import hashlib
import json
import os
import resource
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

# Seconds after which a process ends that a decoder leaves behind.
LINGERS = 30
# A test finds this command by its mark, even without an environment.
NAP = ["sleep", f"{LINGERS}.{os.environ.get('C3GS_TEST_MARK', '')}"]
STEERS = (
    b"\x1b[31m \x1b]0;title\x07 \x9b31m \x00 \xc2\x9b31m \xe2\x80\xae\xd9\x84 \xff\xfe \xed\xa0\x80 </pre><script>\n"
    b"\x1b]52;c;aGk=\x07 a last line that is not JSON\r\x08\x7f"
)


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


def in_background(work, *, twice=True):
    """Runs a function in a session of its own; twice: in a process whose parent has ended."""
    if os.fork():
        return
    os.setsid()
    if twice and os.fork():
        os._exit(0)
    try:
        work()
    finally:
        os._exit(0)


def linger():
    time.sleep(LINGERS)


def grow(path):
    """Appends to a file again and again."""
    end = time.monotonic() + LINGERS
    while time.monotonic() < end:
        with path.open("ab") as file:
            file.write(b"more")
        time.sleep(0.001)


def eat():
    held = []
    while len(held) < 100:
        held.append(bytes(8 << 20) + b"x")
    linger()


def flood(number):
    while True:
        os.write(number, b"x" * (1 << 20))


def misuse(mode, source, output):
    """Misuses the folder of a vector."""
    folder = source.parent.parent
    match mode:
        case "output-is-a-folder":
            output.mkdir()
            (output / "more").write_bytes(b"")
        case "output-is-a-link":
            output.symlink_to("/dev/zero")
        case "output-is-a-fifo":
            os.mkfifo(output)
        case "output-is-a-socket":
            os.chdir(output.parent)
            socket.socket(socket.AF_UNIX).bind(output.name)
        case "output-has-a-hole":
            with output.open("wb") as file:
                file.truncate(64 << 20)
        case "output-is-giant":
            with output.open("wb") as file:
                while True:
                    file.write(bytes(1 << 20))
        case "output-grows":
            in_background(lambda: grow(output))
            while not output.exists() or output.stat().st_size < 8:
                time.sleep(0.001)
        case "folder-is-gone" | "folder-is-another":
            (folder / "read").chmod(0o700)
            shutil.rmtree(folder)
            if mode == "folder-is-another":
                output.parent.mkdir(parents=True)
                output.write_bytes(b"")
        case "folder-is-a-link":
            (folder / "read").chmod(0o700)
            shutil.rmtree(folder)
            folder.symlink_to(Path(__file__).parent)
        case "folder-is-closed":
            folder.chmod(0)
        case "part-is-closed":
            output.parent.chmod(0)
        case "input-is-gone" | "input-is-a-link":
            source.parent.chmod(0o700)
            source.unlink()
            if mode == "input-is-a-link":
                source.symlink_to(output)
            source.parent.chmod(0o555)
        case "input-is-another":
            size = source.stat().st_size
            source.chmod(0o600)
            source.write_bytes(bytes(size))
        case "many-files":
            for number in range(3000):
                (output.parent / f"{number}").write_bytes(b"x")
        case "deep-folders":
            os.chdir(folder / "temporary")
            for _ in range(500):
                os.mkdir("a-folder-in-a-folder")
                os.chdir("a-folder-in-a-folder")
        case "much-on-the-disk":
            for number in range(6):
                with (folder / "temporary" / f"{number}").open("wb") as file:
                    os.posix_fallocate(file.fileno(), 0, 60 << 20)
        case "odd-names":
            for odd in (b"\n", b"\x1b[31m", b"\xff\xfe", "\u202e".encode(), b"-rf", b"a" * 200):
                Path(os.fsdecode(os.fsencode(output) + odd)).write_bytes(b"")
        case "cwd-is-gone":
            shutil.rmtree(Path.cwd())
        case "changes-suite":
            Path(os.environ["FAKE_DECODER_CHANGES"]).write_bytes(b"")
    return 0


def main(mode, answers, name, target, *rest):
    source, output, trace = Path(name), Path(target), Path(rest[0]) if rest else None
    known = json.loads(Path(answers).read_text())[hashlib.sha256(source.read_bytes()).hexdigest()]
    mode, good = known["mode"] if mode == "listed" else mode, known["exit"] == 0
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
            refuse(1, 103, 16)
            os.kill(os.getpid(), signal.SIGSEGV)
        case "hang":
            linger()
        case "hang-in-child":
            subprocess.run(NAP, check=False)
        case "spins":
            while True:
                pass
        case "stops-itself":
            os.kill(os.getpid(), signal.SIGSTOP)
        case "memory":
            eat()
        case "memory-of-child":
            code = f"import time; held = b'x' * {800 << 20}; time.sleep({LINGERS})"
            subprocess.Popen([sys.executable, "-S", "-c", code], env={}, start_new_session=True)
            time.sleep(5)
        case "memory-of-daemon":
            in_background(eat)
            linger()
        case "children":
            for _ in range(200):
                subprocess.Popen(NAP)
            linger()
        case "daemons-hold-stderr":
            for twice in (False, True):
                in_background(linger, twice=twice)
        case "child-of-a-right-decoder":
            subprocess.Popen(NAP, env={})
        case "daemon-of-a-right-decoder":
            in_background(linger)
        case "kills-its-group":
            os.kill(0, signal.SIGKILL)
        case "much-on-stderr":
            flood(2)
        case "much-on-stdout":
            flood(1)
        case "closes-everything":
            os.closerange(0, 256)
            os._exit(0)
        case "talks-much":
            sys.stderr.write("a line of talk\n" * 50_000)
            print("and much on stdout " * 100_000)
        case "limits-and-is-nice":
            os.nice(19)
            resource.setrlimit(resource.RLIMIT_NOFILE, (0, 0))
            output.write_bytes(b"")
        case "dumps-core":
            os.abort()
        case "text-that-steers":
            os.write(2, STEERS)
            return 1
        case "looks-around":
            limits = [resource.getrlimit(limit)[1] for limit in (resource.RLIMIT_FSIZE, resource.RLIMIT_CORE)]
            place = Path(os.environ["TMPDIR"])
            ours = (place.parent, sorted(place.iterdir())) == (source.parents[1], [])
            if not ours or limits != [64 << 20, 0] or any((p / "manifest.json").exists() for p in source.parents):
                return 71
        case "closed-temporary":
            for part in ("a/b", "c"):
                place = source.parents[1] / "temporary" / part
                place.mkdir(parents=True)
                (place / "file").write_bytes(b"x")
                place.chmod(0)
        case "json-and-output" if good:
            right(known, output, trace)
            return refuse(1, 103, 16)
        case "right-exit-1" if good:
            right(known, output, trace)
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
        case "json-exit-0" | "exit-3" | "always-exit-1" if not good:
            status = {"json-exit-0": 0, "exit-3": 3}.get(mode, 1)
            return refuse(status, known["code"], known["offset"])
        case "json-then-text" if not good:
            refuse(1, known["code"], known["offset"])
            print("the end", file=sys.stderr)
            return 1
        case "no-offset" | "offset-1" if not good:
            return refuse(known["exit"], known["code"], known["offset"] + 1 if mode == "offset-1" else None)
        case "other-code" if not good:
            same = {"malformed": 103, "invalid": 212, "unsupported": 205}
            return refuse(known["exit"], same[known["class"]], known["offset"])
        case _ if mode.split("-")[0] in ("output", "folder", "part", "input", "many", "deep", "much", "odd", "cwd"):
            return misuse(mode, source, output)
        case "changes-suite":
            misuse(mode, source, output)
    return right(known, output, trace)


def serve(answers):
    """Answers requests. What a mode does not replace is right."""
    known, stale = json.loads(Path(answers).read_text()), ""
    for line in sys.stdin:
        if stale:
            print(stale, flush=True)
            time.sleep(5)
        q = json.loads(line)
        a = known[hashlib.sha256(Path(q["input"]).read_bytes()).hexdigest()]
        said, output = {"id": q["id"], "status": a["exit"]}, Path(q["output"])
        if a["exit"]:
            said["stderr"] = json.dumps({"code": a["code"], "offset": a["offset"]})
        else:
            output.write_bytes(Path(a["output"]).read_bytes())
        more = {
            "signal": {"status": None, "signal": 11},
            "both": {"signal": 11},
            "text": {"status": "0"},
            "of-another": {"id": q["id"] + 1},
            "steers": {"status": 1, "stderr": "\x1b]0;x\x07\ud800\u202e"},
        }
        text = json.dumps(said | more.get(a["mode"], {}))
        match a["mode"]:
            case "dies":
                os.abort()
            case "leaves":
                sys.exit(0)
            case "eats":
                eat()
            case "late":
                subprocess.run(NAP, check=False)
            case "part-of-a-line":
                os.write(1, text[:3].encode())
                linger()
            case "closes-stdout":
                os.close(1)
                linger()
            case "floods-stdout" | "floods-stderr":
                flood(1 + a["mode"].endswith("err"))
            case "many-children":
                for _ in range(200):
                    subprocess.Popen(NAP)
                linger()
            case "few-children":
                subprocess.Popen(NAP)
                in_background(linger)
            case "no-output":
                output.unlink()
            case "wrong":
                output.write_bytes(output.read_bytes() + b"x")
            case "folder":
                output.unlink()
                output.mkdir()
            case "garbage":
                text = "accepted"
            case "list":
                text = "[0]"
            case "endless":
                text = " " * (1 << 22) + text
            case "deep":
                text = '{"status": 0, "more": ' + "[" * 5000 + "]" * 5000 + "}"
            case "digits":
                text = '{"status": ' + "9" * 100_000 + "}"
            case "not-utf-8":
                os.write(1, b'\xff\xfe{"status": 0}\n')
                continue
            case "twice":
                text += "\n" + text
            case "later-again":
                stale = text
        with contextlib.suppress(BrokenPipeError):
            print(text, flush=True)


if __name__ == "__main__":
    if len(sys.argv) == 3:
        serve(sys.argv[2])
    else:
        sys.exit(main(*sys.argv[1:]))
