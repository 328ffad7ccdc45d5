"""The native kernel against NumPy: the same scenes, files and errors, bit by bit, by every variant."""

import ctypes
import importlib.util
import os
import platform
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from c_compiler import COMPILER, ROOT, Use, build_kernel, sanitizer
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from random_scenes import random_scene

from conformance.cases.checksums import repair
from conformance.cases.scenes import CONSTANT, MAIN_DIMENSIONS, PLANELESS, UNENCODED
from conformance.cases.target import Target
from conformance.cases.weights import packed_weights
from conformance.fuzz import compare
from conformance.fuzz.strategies import draw_mutation, draw_splice
from conformance.manifest import Accepted, Rejected, Vector, load
from refcodec import statuses
from refcodec.bitstream import (
    batches,
    codec,
    directory,
    entropy,
    planes,
    positions,
    reader,
    reconstruction,
    source,
    weights,
)
from refcodec.bitstream.chunks import PARTS
from refcodec.bitstream.errors import BitstreamError
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.tables import tables_bytes
from refcodec.cli.main import main
from refcodec.encoder.positions import position_model
from refcodec.native import library

VARIANTS = ["plain", "avx2", "avx512", "avx512vnni", "neon"]
SUITE = load()
DECODED = [v for v in SUITE.vectors if v.operation == "decode"]
REJECTED = [v for v in DECODED if isinstance(v.expectation, Rejected)]


def verdict(data: bytes) -> tuple[Any, ...]:
    """What is made of a file: digest, error, or fault."""
    try:
        return (reconstruction.digest(codec.parse(data).scene)[0],)
    except BitstreamError as error:
        return error.kind.code, error.offset, str(error)


@contextmanager
def by_numpy() -> Iterator[None]:
    """NumPy decodes and encodes, whatever else is chosen."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(library.PATH_VARIABLE, library.NUMPY)
        yield


def expected(vector: Vector) -> tuple[Any, ...]:
    e = vector.expectation
    if isinstance(e, Rejected):
        return e.code, e.offset
    return (e.digest,)


# --- the same results -------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.requirement("D9.3-1", "D10.2-1")
@pytest.mark.parametrize("path", ["numpy", *VARIANTS])
def test_the_vectors(use: Use, path: str) -> None:
    """Each is decoded to its digest, or refused with its error. The encoder makes each accepted file again."""
    use(path)
    for vector in DECODED:
        data = SUITE.path(vector).read_bytes()
        assert verdict(data)[:2] == expected(vector), vector.id
        if isinstance(vector.expectation, Accepted) and path != "numpy":
            assert codec.emit(codec.parse(data).scene) == data, vector.id


@pytest.mark.requirement("D13.1-1")
def test_nothing_is_decoded_twice(use: Use, monkeypatch: pytest.MonkeyPatch) -> None:
    """The texts of errors are those of NumPy, which decodes nothing for them."""
    some = {v.expectation.code: SUITE.path(v).read_bytes() for v in REJECTED}  # type: ignore[union-attr]
    assert set(some) >= {446, 447, 451, 452, 453, 454, 501, 502, 503, 504, 505, 506, 507, 508, 509}
    with by_numpy():
        wanted = {code: verdict(data) for code, data in some.items()}
    use("native")
    for module in (entropy, batches, planes, positions, weights):
        monkeypatch.setattr(module, "Decoder", None)
    assert {code: verdict(data) for code, data in some.items()} == wanted


def large_scenes() -> dict[str, Scene]:
    """More anchors than a block, several chunks, and lanes to both sides of a vector's."""
    mixed = random_scene(41, 700, chunk_size=300, lanes=Lanes(2, 3, 4))
    return {
        "one lane": random_scene(42, 333, lanes=Lanes(0, 0, 0)),
        "eight lanes": packed_weights(replace(mixed, position_model=position_model(mixed.positions, 300))),
        "256 lanes": random_scene(43, 900, MAIN_DIMENSIONS, chunk_size=400, lanes=Lanes(8, 8, 8)),
        "no planes": random_scene(44, 150, PLANELESS, lanes=Lanes(1, 4, 5)),
        "no inputs": random_scene(45, 150, UNENCODED, lanes=Lanes(1, 5, 6)),
        "no slice but one": random_scene(46, 150, CONSTANT, lanes=Lanes(1, 6, 7)),
    }


LARGE = large_scenes()
with by_numpy():
    FILES = {name: codec.emit(scene) for name, scene in LARGE.items()}


@pytest.mark.no_cover
@pytest.mark.parametrize("name", LARGE)
@pytest.mark.parametrize("path", VARIANTS)
def test_large_scenes(use: Use, path: str, name: str) -> None:
    use(path)
    assert codec.emit(LARGE[name]) == FILES[name]
    assert verdict(FILES[name]) == (reconstruction.digest(LARGE[name])[0],)


@pytest.mark.no_cover
@pytest.mark.parametrize("name", LARGE)
@settings(suppress_health_check=[*HealthCheck], max_examples=15)
@given(st.data())
def test_changed_files(use: Use, name: str, data: st.DataObject) -> None:
    """The same error at the same place with the same text, or the same scene. Checksums are right."""
    use("native")
    for other in (draw_mutation(data.draw, FILES[name]), draw_splice(data.draw, FILES[name])):
        with by_numpy():
            wanted = verdict(other)
        assert verdict(other) == wanted


def test_threads_change_nothing(use: Use) -> None:
    use("native", 1)
    scene = random_scene(47, 640, chunk_size=40)
    one = codec.emit(scene)
    use("native", 4)
    assert codec.emit(scene) == one
    assert verdict(one) == (reconstruction.digest(scene)[0],)


def test_a_trace_is_numpys(use: Use) -> None:
    """The kernel tells of no symbols."""
    use("native")
    rows: list[object] = []
    codec.parse(FILES["one lane"], trace=rows.append)
    with by_numpy():
        again: list[object] = []
        codec.parse(FILES["one lane"], trace=again.append)
    assert rows == again
    assert rows


@pytest.mark.parametrize("most", [0, 1 << 40])
def test_anchors_are_decoded_to_their_place_or_joined(use: Use, monkeypatch: pytest.MonkeyPatch, most: int) -> None:
    """The scene is the same. A damaged chunk is left out."""
    use("native")
    data, scene = FILES["eight lanes"], LARGE["eight lanes"]
    monkeypatch.setattr(codec, "ROOM_OF_A_BYTE", most)
    assert verdict(data) == (reconstruction.digest(scene)[0],)
    target = Target(data)
    broken = target.put(target.part("masks", 1)[0], b"\xff\xff")
    parsed = codec.parse(broken, keep_going=True)
    with by_numpy():
        wanted = codec.parse(broken, keep_going=True)
    assert list(parsed.damage) == list(wanted.damage) == [1]
    assert reconstruction.digest(parsed.scene) == reconstruction.digest(wanted.scene)


def test_many_anchors_of_few_bytes_get_no_room(use: Use) -> None:
    """Room for all anchors is made only where the file has bytes for them."""
    use("native")
    opened = reader.Reader(source.WholeFile(FILES["256 lanes"])).open()
    native = opened.native
    needed = opened.header.anchor_count * native.anchor_bytes()
    room = native.room(opened.header.anchor_count)
    assert needed == sum(array.nbytes for array in vars(room).values())
    opened.hold_whole(needed - 1)
    assert opened._whole is None
    opened.hold_whole(needed)
    assert opened._whole is not None


# --- what cannot be encoded -------------------------------------------------------------------------------------------


def changed(scene: Scene, what: str) -> Scene:
    attributes = scene.attributes
    features = attributes.features.copy()
    features[-1, -1] = 1 << 23
    return {
        "a large feature": replace(scene, attributes=replace(attributes, features=features)),
        "another step": replace(scene, attributes=replace(attributes, steps=attributes.steps ^ 1)),
        "another form": replace(scene, position_forms=(1,) * len(scene.chunks)),
    }[what]


@pytest.mark.parametrize("what", ["a large feature", "another step", "another form"])
def test_what_numpy_does_not_encode(use: Use, monkeypatch: pytest.MonkeyPatch, what: str) -> None:
    """The error is that of NumPy, which encodes nothing for it."""
    use("native")
    scene = changed(LARGE["256 lanes"], what)
    with by_numpy(), pytest.raises(ValueError, match=r"SPEC\.md") as wanted:
        codec.emit(scene)
    for module in (codec, planes, positions, weights):
        monkeypatch.setattr(module, "Encoder", None)
    with pytest.raises(ValueError, match=r"SPEC\.md") as caught:
        codec.emit(scene)
    assert str(caught.value) == str(wanted.value)


# --- faults of ours ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("status", [447, 451, 501, library.REFUSED, library.NO_MEMORY])
def test_disagreement_is_a_fault_of_ours(use: Use, monkeypatch: pytest.MonkeyPatch, status: int) -> None:
    """Were the kernel to refuse what the checks in Python allow, or to find no memory, there would be no verdict."""
    use("native")
    used = library.kernel()
    assert used is not None

    class Wrong:
        """The library, which says that the last chunk has an error."""

        def __getattr__(self, name: str) -> Any:
            return getattr(used.library, name)

        def kernel_decode_chunks(self, scene: int, jobs: Any, count: int, threads: int) -> None:
            used.library.kernel_decode_chunks(scene, jobs, count, threads)
            jobs[count - 1].verdict.status = status

    monkeypatch.setattr(reader, "kernel", lambda: replace(used, library=Wrong()))
    with pytest.raises((RuntimeError, MemoryError)) as caught:
        codec.parse(FILES["one lane"])
    assert isinstance(caught.value, MemoryError) == (status == library.NO_MEMORY)


def test_descriptions_that_are_not_allowed(use: Use) -> None:
    """The kernel takes no scene whose sizes it does not know to be small."""
    use("native")
    used = library.kernel()
    tables = used.library.kernel_tables_new(tables_bytes(), len(tables_bytes()))
    for field, value in (("offset_count", 17), ("plane_size", 1025), ("slice_count", 17), ("mask_lanes", 3)):
        description = library.KernelDescription(
            offset_count=1, slice_count=1, hyper_layers=1, carm_layers=1, cell_shift=-1
        )
        description.slice_width[0] = 1
        description.plane_lanes = description.mask_lanes = description.attribute_lanes = 1
        setattr(description, field, value)
        assert not used.library.kernel_scene_new(ctypes.byref(description), tables, used.variant)
    used.library.kernel_tables_free(tables)
    for wrong in (b"", tables_bytes()[:-1], tables_bytes() + b"\0", bytes(len(tables_bytes()))):
        assert not used.library.kernel_tables_new(wrong, len(wrong))


# --- the choice -------------------------------------------------------------------------------------------------------


def test_without_the_library(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(library, "load", lambda: None)
    monkeypatch.delenv(library.PATH_VARIABLE, raising=False)
    assert library.kernel() is None
    assert verdict(FILES["one lane"]) == (reconstruction.digest(LARGE["one lane"])[0],)
    assert codec.emit(LARGE["one lane"]) == FILES["one lane"]
    assert main(["--version"]) == statuses.DONE
    assert "NumPy; the native kernel is not there" in capsys.readouterr().out
    monkeypatch.setenv(library.PATH_VARIABLE, library.NATIVE)
    with pytest.raises(statuses.UsageError, match=r"on this machine it must be one of numpy$"):
        codec.parse(FILES["one lane"])


def test_files_that_are_not_the_library(tmp_path: Path) -> None:
    file = tmp_path / "kernel.so"
    assert library.load(file) is None
    file.write_bytes(b"no library")
    assert library.load(file) is None


@pytest.mark.parametrize(
    ("name", "value", "what"),
    [
        (library.PATH_VARIABLE, "fast\n", "REFCODEC_PATH is 'fast\\n'; on this machine it must be one of numpy, "),
        (library.THREADS_VARIABLE, "0", "REFCODEC_THREADS is '0'; it may be 1 to 256"),
        (library.THREADS_VARIABLE, "9" * 5000, "it may be 1 to 256"),
        (library.THREADS_VARIABLE, "two", "it may be 1 to 256"),
    ],
)
def test_wrong_choices(
    use: Use,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    name: str,
    value: str,
    what: str,
) -> None:
    """One line, and the status of wrong usage."""
    use("native")
    monkeypatch.setenv(name, value)
    file = tmp_path / "scene.c3gs"
    file.write_bytes(FILES["one lane"])
    for command in (["validate", str(file)], ["--version"]):
        assert main(command) == statuses.USAGE
        printed = capsys.readouterr()
        assert what in printed.err
        assert printed.err.count("\n") == 1
        assert printed.out == ""


def test_what_is_used_is_told(use: Use, capsys: pytest.CaptureFixture[str]) -> None:
    """With the reason if a slower path is selected than the processor allows."""
    use(library.NATIVE)
    loaded = library.load()
    assert loaded is not None
    *_, (_, best) = library.variants(loaded)
    reason = "" if best == "plain" else f"; REFCODEC_PATH excludes {best}, which is faster"
    for path, threads, words in (("plain", 1, "plain, 1 thread"), ("plain", 3, "plain, 3 threads")):
        use(path, threads)
        assert main(["--version"]) == statuses.DONE
        assert capsys.readouterr().out.endswith(f"native kernel {words}{reason}\n")
    use(library.NUMPY)
    assert library.describe() == f"NumPy; REFCODEC_PATH excludes {best}, which is faster"
    for path in (library.NATIVE, best):
        use(path)
        assert library.describe() == f"native kernel {best}, 1 thread"


# --- the processor ----------------------------------------------------------------------------------------------------

X86 = pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="cpuid is of x86-64")
# The flags of Linux that a variant needs besides those of the variant before it.
FLAGS = {
    "plain": "sse2",
    "avx2": "avx avx2 bmi1 bmi2 fma popcnt abm pclmulqdq",
    "avx512": "avx512f avx512bw avx512dq avx512vl",
    "avx512vnni": "avx512_vnni",
}


@X86
def test_the_variants_are_those_of_the_systems_flags(built: Path) -> None:
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        pytest.skip("the system states no flags of its processor")
    lines = [line.partition(":")[2].split() for line in text.splitlines() if line.startswith("flags")]
    loaded, wanted = library.load(built), []
    assert lines
    assert loaded is not None
    for name, flags in FLAGS.items():
        if not set(flags.split()) <= set(lines[0]):
            break
        wanted.append(name)
    assert [name for _, name in library.variants(loaded)] == wanted


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("ziglang") is None, reason="ziglang is not installed")
def test_another_compiler_chooses_the_same_variant(built: Path, tmp_path: Path) -> None:
    """zig links no run-time library of GCC, whose test of the processor then reports nothing."""
    other = library.load(build_kernel(tmp_path, CC=f"{sys.executable} -m ziglang cc"))
    own = library.load(built)
    assert own is not None
    assert other is not None
    assert list(library.variants(other)) == list(library.variants(own))


# The choice for other registers than those of this machine.
CHOICE = """
#include "kernel.c"
KERNEL_API int32_t choice(const uint32_t *numbers)
{
    registers r;
    memcpy(&r, numbers, sizeof r);
    return best_variant(r);
}
"""


def bits(*numbers: int) -> int:
    return sum(1 << number for number in numbers)


@X86
@pytest.mark.skipif(COMPILER is None, reason="there is no C compiler")
def test_the_choice_for_any_registers(tmp_path: Path) -> None:
    """A variant needs all its instructions, and an operating system that saves its registers."""
    source, path = tmp_path / "choice.c", tmp_path / "choice.so"
    source.write_text(CHOICE, encoding="utf-8")
    flags = ["-std=gnu11", "-O0", "-w", "-fPIC", "-shared", "-pthread", "-I", str(ROOT / "refcodec" / "native")]
    subprocess.run([str(COMPILER), *flags, str(source), "-o", str(path)], check=True)
    choice = ctypes.CDLL(str(path)).choice
    # ECX of leaf 1: PCLMULQDQ, FMA, POPCNT, OSXSAVE, AVX. EBX of leaf 7: BMI1, AVX2, BMI2, AVX512F, DQ, BW, VL.
    # ECX of leaf 7: AVX512_VNNI. ECX of leaf 0x80000001: LZCNT. XCR0: XMM, YMM, opmask, both parts of ZMM.
    needed = [[1, 12, 23, 27, 28], [3, 5, 8, 16, 17, 30, 31], [11], [5], [1, 2, 5, 6, 7]]

    def chosen(numbers: list[list[int]]) -> str:
        return list(FLAGS)[choice((ctypes.c_uint32 * 5)(*(bits(*register) for register in numbers)))]

    assert chosen(needed) == "avx512vnni"
    assert chosen([[]] * 5) == "plain"
    without = {
        (register, bit): chosen([[b for b in r if (i, b) != (register, bit)] for i, r in enumerate(needed)])
        for register, r in enumerate(needed)
        for bit in r
    }
    assert without == {
        **{(0, bit): "plain" for bit in needed[0]},
        **{(1, bit): "plain" if bit < 16 else "avx2" for bit in needed[1]},
        (2, 11): "avx512",
        (3, 5): "plain",
        **{(4, bit): "plain" if bit < 5 else "avx2" for bit in needed[4]},
    }
    # The operating system saves nothing, whatever the processor has.
    assert chosen([*([*range(32)] for _ in range(4)), []]) == "plain"


# --- sanitizers -------------------------------------------------------------------------------------------------------

# Decodes and encodes files with a library: each file by half of its variants, in turn. Any fault ends the process.
SANITIZED = """
import os, sys
from pathlib import Path
from refcodec.bitstream import codec, reconstruction
from refcodec.bitstream.errors import BitstreamError
from refcodec.native import library
code = library.load(Path(sys.argv[1]))
assert code is not None
library.load = lambda: code
os.environ[library.THREADS_VARIABLE] = "2"
for number, name in library.variants(code):
    os.environ[library.PATH_VARIABLE] = name
    for path in sorted(Path(sys.argv[2]).iterdir())[number % 2 :: 2]:
        data = path.read_bytes()
        try:
            scene = codec.parse(data).scene
            reconstruction.digest(scene)
            assert codec.emit(scene) == data
        except BitstreamError:
            pass
print("done")
"""

# SPLAT (SPEC 9.4) of sizes, numbers and room that no file gives, in blocks of their sizes, with and without gaps.
SANITIZED_SPLAT = """
import itertools, sys
from pathlib import Path
import numpy as np
from refcodec.bitstream.dimensions import RENDERING
from refcodec.bitstream.networks import IntLayer, IntNetwork
from refcodec.bitstream.splat import splat
from refcodec.native import library
code = library.load(Path(sys.argv[1]))
rng = np.random.default_rng(94)
EXTREME = [0.0, -0.0, 1e-45, -1e30, 3e38, -3e38, np.inf, -np.inf, np.nan]

def places(*arrays):
    return [array.ctypes.data for array in arrays]

def networks(variant, inputs, width, k, colours):
    # Many weights are 0, so that pairs of inputs are left out, and units.
    dense = rng.choice([0.02, 0.2, 1])
    def layer(outputs, own):
        weight = rng.integers(-100, 100, (outputs, own)) * (rng.random((outputs, own)) < dense)
        return weight, rng.integers(-9999, 9999, outputs), rng.integers(0, 12, outputs)
    layers = [layer(*shape) for n in (1, 7, colours) for shape in ((width, inputs), (n * k, width))]
    flat = [np.concatenate([part.ravel() for part in parts]) for parts in zip(*layers)]
    joined = [part.astype(kind) for part, kind in zip(flat, ("i2", "i4", "u1"))]
    return code.kernel_splatter_new(variant, inputs, width, k, colours, *places(*joined)), layers

for sizes in ((0, 7, 3, 3), (129, 7, 3, 3), (5, 0, 3, 3), (5, 129, 3, 3), (5, 7, 0, 3), (5, 7, 17, 3), (5, 7, 3, 49)):
    assert not networks(0, *sizes)[0]
SIZES = (5, 7, 3, 12), (1, 1, 1, 3), (50, 128, 16, 48), (128, 9, 10, 27), (35, 114, 1, 27)
for (variant, _), sizes, n in itertools.product(library.variants(code), SIZES, (0, 1, 150, 2100)):
    made, layers = networks(variant, *sizes)
    inputs, _, k, colours = sizes
    columns = (3, 3, 4, 1, colours)
    masks = rng.random((n, k)) < 0.6
    kept = int(masks.sum())
    for extreme in (False, True):
        values = [rng.normal(0, size, (n, *shape)).astype("f4") for size, shape in (
            (1, (3,)), (600, (inputs,)), (12, (6,)), (1, (k, 3)))]
        for value in values if extreme else ():
            value.ravel()[rng.random(value.size) < 0.3] = rng.choice(EXTREME)
        for room in {kept, max(kept - 1, 0)}:
            rows = np.empty((room, 11 + colours), "f4")
            apart = [np.empty((room, width), "f4") for width in columns]
            given = [made, n, *places(values[0], masks, *values[1:]), None, None, room]
            starts = [rows.ctypes.data + 4 * at for at in (0, 3, 6, 10, 11)]
            to = (11 + colours, *starts, 1), (0, *places(*apart), 2)
            counts = {code.kernel_splat(*given, *own) for own in to}
            assert counts == {kept if room == kept else library.REFUSED}
            if room == kept:
                assert np.hstack(apart).tobytes() == rows.tobytes()
            if room == kept and not extreme:
                own = [IntNetwork([IntLayer(*layer) for layer in layers[i : i + 2]]) for i in (0, 2, 4)]
                assert splat(dict(zip(RENDERING, own)), *values, masks).tobytes() == rows.tobytes()
    code.kernel_free(made)
print("done")
"""


def planted(data: bytes, rng: np.random.Generator) -> Iterator[bytes]:
    """The file with faults in the parts of its chunks and in its planes, checksums right."""
    target = Target(data)
    for chunk in range(target.header.chunk_count):
        for kind in PARTS:
            first, end = target.part(kind, chunk)
            # The head of a substream, and any byte behind it: words, states and raw bits.
            for at in (first + 4, *rng.integers(first, end, 4).tolist()):
                yield repair(target.put(int(at), rng.bytes(min(4, end - int(at)))))
            yield repair(target.put(first, bytes(end - first)))
            yield repair(target.put(first, b"\xff" * (end - first)))
    if directory.PLANES_SECTION in target.sections:
        section = target.sections[directory.PLANES_SECTION]
        for at in rng.integers(section.start + 20, section.end, 8).tolist():
            yield repair(target.put(int(at), b"\xff"))


@pytest.mark.slow
@pytest.mark.no_cover
@pytest.mark.requirement("D13.1-1")
@pytest.mark.skipif(sanitizer() is None, reason="there is no address sanitizer")
def test_sanitizers_are_silent(tmp_path: Path) -> None:
    """Over all vectors, large files, those with each part of a chunk cut and changed, files of the fuzzer, SPLAT."""
    flags = ["-std=gnu11", "-O1", "-g", "-Wall", "-Wextra", "-Werror", "-fPIC", "-shared", "-fvisibility=hidden"]
    flags += ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-pthread"]
    assert COMPILER is not None
    built, folder = tmp_path / "kernel.so", tmp_path / "files"
    subprocess.run([COMPILER, *flags, *sorted((ROOT / "refcodec/native").glob("*.c")), "-o", built], check=True)
    folder.mkdir()
    rng = np.random.default_rng(0)
    contents = [SUITE.path(v).read_bytes() for v in DECODED] + list(FILES.values())
    contents += [other for data in FILES.values() for other in planted(data, rng)]
    # A batch of the fuzzer has about 500 files.
    contents += [data for data, _ in compare.batch(0)]
    for i, data in enumerate(contents):
        (folder / f"{i:05}").write_bytes(data)
    # Python itself leaks.
    environment = {**os.environ, "LD_PRELOAD": str(sanitizer()), "ASAN_OPTIONS": "detect_leaks=0"}
    for program in (SANITIZED_SPLAT, SANITIZED):
        command = [sys.executable, "-c", program, str(built), str(folder)]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stdout) == (0, "done\n"), done.stderr[-3000:]
