"""A decoder that attacks whoever runs it: for one file in the way that its first argument says, else rightly.

hostile_decoder.py ATTACK VICTIM ANSWERS INPUT OUTPUT; VICTIM: the SHA-256 of the file. The rest is as in
fake_decoder.py. Every attack is bounded, so that it does little harm where the runner does not hold it.
"""

import contextlib
import hashlib
import os
import resource
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import fake_decoder

# What a decoder leaves behind is gone by itself after so many seconds.
LINGERS = 30
HOSTILE_TEXT = (
    b"\x1b[31m \x1b]0;title\x07 \x9b31m \x00 \xc2\x9b31m \xe2\x80\xae\xd9\x84 \xff\xfe \xed\xa0\x80 </pre><script>\n"
    b"\x1b]52;c;aGk=\x07 a last line, which is no JSON\r\x08\x7f"
)


def in_background(work, twice=False):
    """Runs a function in a session of its own; twice: whose parent has ended."""
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


def hop():
    """A process that is another one all the time."""
    end = time.monotonic() + LINGERS
    while time.monotonic() < end:
        if os.fork():
            os._exit(0)
        os.setsid()


def eat():
    held = []
    end = time.monotonic() + LINGERS
    while time.monotonic() < end:
        if len(held) < 100:
            held.append(bytes(8 << 20) + b"x")
        else:
            time.sleep(0.1)


def refuse(line):
    sys.stderr.buffer.write(line + b"\n")
    return 1


def attack(name, source, output, answer):
    folder = source.parent.parent
    match name:
        case "output-is-a-folder":
            output.mkdir()
            (output / "more").write_bytes(b"")
        case "output-is-a-link":
            output.symlink_to(__file__)
        case "output-is-a-link-to-the-answer":
            output.symlink_to(answer["output"])
        case "output-is-a-link-to-a-device":
            output.symlink_to("/dev/zero")
        case "output-is-a-fifo":
            os.mkfifo(output)
        case "output-is-a-socket":
            os.chdir(output.parent)
            socket.socket(socket.AF_UNIX).bind(output.name)
        case "output-has-a-hole":
            with contextlib.suppress(ValueError):  # only a privileged process may
                resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY,) * 2)
            signal.signal(signal.SIGXFSZ, signal.SIG_DFL)
            with output.open("wb") as file:
                file.write(b"x")
                file.truncate(1 << 40)
        case "output-grows":
            in_background(lambda: grow(output), twice=True)
            while not output.exists() or output.stat().st_size < 8:
                time.sleep(0.001)
        case "folder-is-gone":
            (folder / "read").chmod(0o700)
            shutil.rmtree(folder)
        case "folder-is-closed":
            output.write_bytes(Path(answer["output"]).read_bytes())
            folder.chmod(0)
        case "part-is-closed":
            output.write_bytes(Path(answer["output"]).read_bytes())
            output.parent.chmod(0)
        case "folder-is-moved":
            folder.rename(folder.with_name("elsewhere"))
        case "folder-is-a-link":
            folder.rename(folder.with_name("elsewhere"))
            folder.symlink_to("elsewhere")
        case "folder-is-another":
            folder.rename(folder.with_name("elsewhere"))
            (folder / "write").mkdir(parents=True)
            output.write_bytes(Path(answer["output"]).read_bytes())
        case "input-is-gone":
            source.parent.chmod(0o700)
            source.unlink()
            source.parent.chmod(0o555)
        case "input-is-another":
            size = source.stat().st_size
            source.chmod(0o600)
            source.write_bytes(bytes(size))
        case "input-is-a-link":
            source.parent.chmod(0o700)
            source.unlink()
            source.symlink_to(output)
            source.parent.chmod(0o555)
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
        case "closed-folders":
            for part in ("temporary/a/b", "temporary/c"):
                (folder / part).mkdir(parents=True)
                (folder / part / "file").write_bytes(b"x")
            for part in ("temporary/a/b", "temporary/a", "temporary/c"):
                (folder / part).chmod(0)
            return fake_decoder.right(answer, output, None)
        case "cwd-is-gone":
            shutil.rmtree(Path.cwd())
        case "many-children":
            for _ in range(200):
                os.posix_spawn("/bin/sleep", ["sleep", str(LINGERS)], os.environ)
            linger()
        case "daemons-hold-stderr":
            for _ in range(3):
                in_background(linger)
        case "daemon":
            in_background(linger, twice=True)
        case "daemon-of-a-right-decoder":
            in_background(linger, twice=True)
            return fake_decoder.right(answer, output, None)
        case "daemon-that-hops":
            in_background(hop, twice=True)
        case "daemon-that-eats":
            in_background(eat, twice=True)
            linger()
        case "daemon-of-another-program":
            subprocess.Popen(["env", "-i", "/bin/sleep", str(LINGERS)], start_new_session=True)
        case "stops-itself":
            os.kill(os.getpid(), signal.SIGSTOP)
        case "kills-its-group":
            os.kill(0, signal.SIGKILL)
        case "kills-its-parents-group":
            in_background(linger)
            os.killpg(os.getpgid(os.getppid()), signal.SIGKILL)
            linger()
        case "stops-its-parent":
            os.kill(os.getppid(), signal.SIGSTOP)
            linger()
        case "much-on-stderr":
            while True:
                os.write(2, b"x" * (1 << 20))
        case "much-on-stdout":
            while True:
                os.write(1, b"x" * (1 << 20))
        case "closes-everything":
            os.closerange(0, 256)
            os._exit(0)
        case "is-another-program":
            os.execv("/bin/true", ["true"])
        case "limits-and-is-nice":
            os.nice(19)
            resource.setrlimit(resource.RLIMIT_NOFILE, (0, 0))
            output.write_bytes(b"")
        case "dumps-core":
            resource.setrlimit(resource.RLIMIT_CORE, (resource.getrlimit(resource.RLIMIT_CORE)[1],) * 2)
            os.abort()
        case "deep-json":
            return refuse(b"[" * 100_000)
        case "deep-json-with-an-end":
            return refuse(b'{"code": 103, "more": ' + b"[" * 2000 + b"]" * 2000 + b"}")
        case "long-code":
            return refuse(b'{"code": ' + b"9" * 1_000_000 + b"}")
        case "long-offset":
            return refuse(b'{"code": 103, "offset": ' + b"9" * 4000 + b"}")
        case "large-offset":
            return refuse(b'{"code": 103, "offset": ' + b"9" * 40 + b"}")
        case "a-code-twice":
            return refuse(b'{"code": 103, "code": 102, "offset": 0}')
        case "the-end-of-a-long-line":
            return refuse(b"x" * (1 << 20) + b'{"code": 103, "offset": 0}')
        case "text-that-steers":
            return refuse(HOSTILE_TEXT)
        case "looks-for-the-manifest":
            found = [place / "manifest.json" for place in [source.parent, *source.parents]]
            return 0 if any(path.exists() for path in found) else 71
        case "exit-64" | "exit-70" | "exit-255":
            return int(name.removeprefix("exit-"))
    return 0


def main(name, victim, answers, source, output):
    if hashlib.sha256(Path(source).read_bytes()).hexdigest() != victim:
        return fake_decoder.main("right", answers, source, output)
    answer = fake_decoder.answer(answers, source)
    return attack(name, Path(source), Path(output), answer)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
