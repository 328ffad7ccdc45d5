"""Exactness (SPEC.md 2, 9.3): nothing that computes a digest changes it. The vectors are files from before."""

import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import pytest
from random_scenes import random_scene
from threadpoolctl import threadpool_info, threadpool_limits

from conformance.cases.scenes import MAIN_DIMENSIONS
from refcodec.bitstream import batches, codec, networks, reader, reconstruction
from refcodec.bitstream.entropy import TraceRow
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.source import WholeFile

# The codec's own limit of one BLAS thread is taken away; that BLAS then has the threads it was given is asserted.
TWO_THREADS = """
import contextlib
import os
import sys
from pathlib import Path
from threadpoolctl import threadpool_info
from refcodec.bitstream import codec, reader, reconstruction
for module in (codec, reader):
    module.one_thread = contextlib.nullcontext
blas = [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]
assert set(blas) <= {min(2, len(os.sched_getaffinity(0)))}, blas
print(reconstruction.digest(codec.parse(Path(sys.argv[1]).read_bytes()).scene)[0])
"""


Change = tuple[ModuleType, str, object]
ONE_CHUNK: Change = (reader, "GROUP_CHUNKS", 1)
INT64: Change = (networks, "float32_is_exact", lambda: False)
VARIANTS: dict[str, list[Change]] = {
    "as it is": [],
    "groups of one chunk": [ONE_CHUNK],
    "groups of few anchors": [(batches, "GROUP_ANCHORS", 300)],
    "blocks of 7 rows": [(networks, "BLOCK_ROWS", 7)],
    "blocks of all rows": [(networks, "BLOCK_ROWS", 1 << 20)],
    "int64": [INT64],
    "one chunk, int64": [ONE_CHUNK, INT64],
}


@pytest.fixture(scope="module")
def main_file(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A file of profile Main with several chunks, and its digest from the encoder's side."""
    scene = random_scene(21, 1500, MAIN_DIMENSIONS, chunk_size=400, lanes=Lanes(3, 2, 3))
    path = tmp_path_factory.mktemp("exact") / "main.c3gs"
    path.write_bytes(codec.emit(scene))
    return path, reconstruction.digest(scene)[0]


@pytest.mark.requirement("D9.3-1")
@pytest.mark.parametrize("traced", [False, True])
@pytest.mark.parametrize("variant", VARIANTS)
def test_one_digest(main_file: tuple[Path, str], variant: str, traced: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    # What the variants change is NumPy's.
    monkeypatch.setenv("REFCODEC_PATH", "numpy")
    for module, name, value in VARIANTS[variant]:
        assert hasattr(module, name)
        monkeypatch.setattr(module, name, value)
    rows: list[TraceRow] = []
    parsed = codec.parse(main_file[0].read_bytes(), trace=rows.append if traced else None)
    assert reconstruction.digest(parsed.scene)[0] == main_file[1]
    assert bool(rows) is traced


@pytest.mark.requirement("D9.3-1")
def test_one_digest_with_two_blas_threads(main_file: tuple[Path, str]) -> None:
    threads = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "2")
    threads["REFCODEC_PATH"] = "numpy"
    command = [sys.executable, "-c", TWO_THREADS, str(main_file[0])]
    done = subprocess.run(command, env={**os.environ, **threads}, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.strip()) == (0, main_file[1]), done.stderr


def blas_threads() -> list[int]:
    return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]


def opened(data: bytes, progress: batches.Progress) -> None:
    reader.Reader(WholeFile(data)).open(progress=progress)


def emitted(data: bytes, progress: batches.Progress) -> None:
    codec.emit(codec.parse(data).scene, progress=progress)


def set_blas_threads(number: int) -> None:
    """Sets them in a thread that ends, so that other threads may set them, too: threadpoolctl demands it."""
    thread = threading.Thread(target=threadpool_limits, args=(number, "blas"))
    thread.start()
    thread.join()


@pytest.fixture
def two_blas_threads() -> Iterator[None]:
    was = max([1, *blas_threads()])
    set_blas_threads(2)
    yield
    set_blas_threads(was)


@pytest.mark.parametrize("first", [opened, emitted])
@pytest.mark.parametrize("second", [opened, emitted])
def test_threads_that_overlap_leave_blas_as_it_was(
    main_file: tuple[Path, str], first: Callable, second: Callable, two_blas_threads: None
) -> None:
    """The first thread enters first and leaves first, while the second one is at work."""
    data, before = main_file[0].read_bytes(), blas_threads()
    begun, entered = threading.Event(), threading.Event()

    def in_first(*steps: object) -> None:
        begun.set()
        assert entered.wait(60)

    thread = threading.Thread(target=first, args=(data, in_first))

    def in_second(*steps: object) -> None:
        entered.set()
        thread.join(60)

    thread.start()
    assert begun.wait(60)
    second(data, in_second)
    assert not thread.is_alive()
    assert blas_threads() == before


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
def test_a_process_that_is_forked_while_another_thread_decodes_has_all_threads(
    main_file: tuple[Path, str], two_blas_threads: None
) -> None:
    data, before = main_file[0].read_bytes(), blas_threads()
    begun, forked = threading.Event(), threading.Event()

    def progress(*steps: object) -> None:
        begun.set()
        assert forked.wait(60)

    thread = threading.Thread(target=opened, args=(data, progress))
    thread.start()
    assert begun.wait(60)
    child = os.fork()
    if not child:
        with batches.one_thread():
            limited = blas_threads()
        os._exit(0 if (limited, blas_threads()) == ([1] * len(before), before) else 3)
    forked.set()
    thread.join(60)
    assert os.waitpid(child, 0)[1] == 0
