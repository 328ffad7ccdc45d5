"""Decoding a file into a folder in steps of some chunks: the result is the folder of the whole scene, or no folder."""

import io
import json
import os
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plyfile import PlyData
from random_scenes import flipped, random_scene
from safetensors.numpy import load_file, save

from refcodec.bitstream import codec, reader, reconstruction
from refcodec.bitstream.bounds import BoundPassedError, Limits, memory_needed
from refcodec.bitstream.errors import BitstreamError
from refcodec.bitstream.reader import Reader, decode_chunk
from refcodec.bitstream.reconstruction import chunk_digest, digest, reconstruct
from refcodec.bitstream.scene import Ancillary, Scene, take_anchors
from refcodec.bitstream.source import Arriving, FileBytes, StoredFile, WholeFile
from refcodec.bitstream.streaming import decoded_chunks
from refcodec.folder import write
from refcodec.folder.arrays import RowsFile
from refcodec.folder.read import read_folder
from refcodec.folder.write import Written, decode_folder, write_folder

# What files that are written take: a buffer each, and what is on its way into it.
BUFFERS = 4 << 20
VECTORS = Path(__file__).resolve().parents[2] / "vectors"
ANCILLARY = (Ancillary(b"noTE", 0, b"before"), Ancillary(b"noTE", 1, b"behind", 5))
SCENE = replace(random_scene(31, 90, chunk_size=16), ancillary=ANCILLARY)
DATA_OF = codec.emit(SCENE)


@pytest.fixture
def small_groups(monkeypatch: pytest.MonkeyPatch) -> None:
    """Groups of two chunks, and blocks of seven anchors."""
    monkeypatch.setattr(reader, "GROUP_ANCHORS", 40)
    monkeypatch.setattr(write, "_ROWS", 7)


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def decoded(data: bytes, folder: Path, numbers: range | None = None, keep_going: bool = False) -> Written:
    """The folder of a file that is decoded chunk after chunk."""
    read = Reader(WholeFile(data), keep_ancillary=numbers is None)
    return decode_folder(read.open(critical_only=numbers is not None), folder, numbers, keep_going=keep_going)


def damaged(*chunks: int) -> bytes:
    """The file with one bit flipped in some chunks."""
    index = Reader(WholeFile(DATA_OF)).open().index
    return flipped(DATA_OF, *(index[number].start + 20 for number in chunks))


# --- the files --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rows", [0, 1, 13])
def test_arrays_in_place_are_what_the_package_writes(rows: int) -> None:
    """Byte for byte, whatever the names, the types and the blocks."""
    rng = np.random.default_rng(rows)
    arrays: dict[str, np.ndarray] = {
        "zeta": rng.integers(0, 99, (rows, 3), np.uint16),
        "b": rng.integers(-99, 99, (rows, 2, 3), np.int32),
        "alpha": rng.integers(0, 99, (rows, 1), np.uint8),
        "a long name": rng.integers(-99, 99, (rows, 5), np.int32),
        "m": rng.integers(0, 9, (rows, 4), np.uint8),
    }
    made = io.BytesIO()
    file = RowsFile(made, {name: (array.dtype, array.shape[1:]) for name, array in arrays.items()}, rows)
    for first in range(0, rows, 4):
        file.add({name: array[first : first + 4] for name, array in arrays.items()})
    assert made.getvalue() == save(arrays)


# --- whole files ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [0, 1, 90])
def test_the_folder_does_not_depend_on_blocks(count: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = codec.emit(replace(random_scene(32, count, chunk_size=16), ancillary=ANCILLARY))
    scene = codec.parse(data).scene
    write_folder(scene, tmp_path / "whole")
    monkeypatch.setattr(reader, "GROUP_ANCHORS", 40)
    monkeypatch.setattr(write, "_ROWS", 7)
    done = decoded(data, tmp_path / "streamed")
    assert (done.anchors, done.damage, done.error) == (count, {}, None)
    assert files(tmp_path / "streamed") == files(tmp_path / "whole")
    whole, parts = digest(scene)
    assert json.loads((tmp_path / "streamed" / "scene.json").read_text())["digest"] == {"whole": whole, **parts}
    assert codec.emit(read_folder(tmp_path / "streamed")) == data


def test_nothing_is_reconstructed_twice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[int] = []
    real = reconstruction.reconstruct

    def counting(scene: Scene) -> reconstruction.Reconstruction:
        seen.append(scene.anchor_count)
        return real(scene)

    monkeypatch.setattr(reconstruction, "reconstruct", counting)
    monkeypatch.setattr(write, "reconstruct", counting)
    decoded(DATA_OF, tmp_path / "whole")
    assert sum(seen) == 90
    seen.clear()
    decoded(DATA_OF, tmp_path / "part", range(1, 3))
    assert seen == [16, 16]


@pytest.mark.usefixtures("small_groups")
@pytest.mark.parametrize("chunks", [[], [0], [5], [1, 2, 4], list(range(6))])
def test_good_chunks_of_a_damaged_file(chunks: list[int], tmp_path: Path) -> None:
    data = damaged(*chunks)
    done = decoded(data, tmp_path / "left", keep_going=True)
    parsed = codec.parse(data, keep_going=True)
    assert {n: e.to_json() for n, e in done.damage.items()} == {n: e.to_json() for n, e in parsed.damage.items()}
    assert (done.anchors, done.lost) == (parsed.scene.anchor_count, parsed.lost)
    assert str(done.error) == str(parsed.error)
    write_folder(parsed.scene, tmp_path / "wanted")
    wanted = files(tmp_path / "wanted")
    document = json.loads(wanted.pop("scene.json"))
    if chunks:
        document["dropped_chunks"] = [{"chunk": n, **json.loads(parsed.damage[n].to_json())} for n in chunks]
    left = files(tmp_path / "left")
    made = json.loads(left.pop("scene.json"))
    assert {**made, "fingerprint": ""} == {**document, "fingerprint": ""}
    assert left == wanted


def test_a_fault_behind_the_chunks_drops_none(tmp_path: Path) -> None:
    done = decoded(DATA_OF + b"x", tmp_path / "left", keep_going=True)
    assert (done.anchors, done.damage, done.error.kind.name) == (90, {}, "file.trailing")


# --- some chunks ------------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("small_groups")
@pytest.mark.parametrize("numbers", [range(0, 1), range(5, 6), range(1, 5), range(0, 6)])
def test_some_chunks_are_rows_of_the_whole(numbers: range, tmp_path: Path) -> None:
    decoded(DATA_OF, tmp_path / "whole")
    done = decoded(DATA_OF, tmp_path / "part", numbers)
    assert done.digests == [chunk_digest(decode_chunk(WholeFile(DATA_OF), number)) for number in numbers]
    rows = slice(16 * numbers.start, min(90, 16 * numbers.stop))
    whole, part = (load_file(tmp_path / name / "coded.safetensors") for name in ("whole", "part"))
    for name, array in whole.items():
        assert np.array_equal(part[name], array[rows]), name
    clouds = [PlyData.read(str(tmp_path / name / "point_cloud.ply"))["vertex"].data for name in ("whole", "part")]
    assert clouds[1].tobytes() == clouds[0][rows].tobytes()
    document = json.loads((tmp_path / "part" / "scene.json").read_text())
    assert document["chunks"] == [numbers.start, numbers.stop]
    scene = read_folder(tmp_path / "part")
    assert digest(scene)[0] == document["digest"]["whole"]


def test_values_come_with_symbols() -> None:
    whole = reconstruct(codec.parse(DATA_OF).scene)
    for source in (WholeFile(DATA_OF), Arriving(DATA_OF[at : at + 100] for at in range(0, len(DATA_OF), 100))):
        chunks = list(decoded_chunks(source, side_by_side=isinstance(source, WholeFile)))
        for name in vars(whole):
            values = np.concatenate([getattr(chunk.values, name) for chunk in chunks])
            assert values.tobytes() == getattr(whole, name).tobytes(), name
        symbols = np.concatenate([chunk.scene.attributes.features for chunk in chunks])
        assert np.array_equal(symbols, SCENE.attributes.features)


def test_chunks_that_are_not_there() -> None:
    for numbers in (range(6, 7), range(5, 7), range(-1, 2)):
        with pytest.raises(IndexError, match="there is no chunk"):
            list(decoded_chunks(WholeFile(DATA_OF), numbers))
    assert list(decoded_chunks(WholeFile(DATA_OF), range(3, 3))) == []


def test_bounds_come_first(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Reader, "open", pytest.fail)
    for side_by_side in (False, True):
        with pytest.raises(BoundPassedError):
            list(decoded_chunks(WholeFile(DATA_OF), side_by_side=side_by_side, limits=Limits(anchors=89)))


# --- files that are refused -------------------------------------------------------------------------------------------

# Others repeat the same code: tests/bitstream/test_reader.py has arriving bytes with any change.
REFUSED = sorted(p for kind in ("invalid", "malformed", "unsupported") for p in (VECTORS / kind).glob("*.c3gs"))[::4]


def test_every_way_refuses_alike(tmp_path: Path) -> None:
    """Vectors that are refused: the same error, and nothing is left behind."""
    assert len(REFUSED) > 100
    folder = tmp_path / "scene"
    for path in REFUSED:
        data = path.read_bytes()
        with pytest.raises(BitstreamError) as wanted:
            codec.parse(data)

        def stored(path: Path = path) -> Any:
            with path.open("rb") as file:
                return decode_folder(Reader(StoredFile(file)).open(), folder)

        def arriving(data: bytes = data) -> Any:
            return list(decoded_chunks(Arriving([data]), side_by_side=False))

        def whole(data: bytes = data) -> Any:
            return list(decoded_chunks(WholeFile(data)))

        for way in (stored, arriving, whole):
            with pytest.raises(BitstreamError) as caught:
                way()
            assert caught.value.to_json() == wanted.value.to_json(), path.name
        assert os.listdir(tmp_path) == []


@pytest.mark.usefixtures("small_groups")
@pytest.mark.parametrize("way", ["interrupted", "refused", "refused at the end"])
def test_a_folder_stays_as_it_was(way: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_folder(random_scene(40, 5), tmp_path / "old")
    before = files(tmp_path / "old")
    data = {"interrupted": DATA_OF, "refused": damaged(4), "refused at the end": DATA_OF + b"x"}[way]
    if way == "interrupted":
        left = 5

        def tiring(scene: Scene) -> reconstruction.Reconstruction:
            nonlocal left
            left -= 1
            if left < 0:
                raise KeyboardInterrupt
            return reconstruct(scene)

        monkeypatch.setattr(write, "reconstruct", tiring)
    for name in ("old", "new"):
        with pytest.raises((KeyboardInterrupt, BitstreamError)):
            decoded(data, tmp_path / name)
        left = 5
    assert files(tmp_path / "old") == before
    assert os.listdir(tmp_path) == ["old"]


# --- memory -----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_memory_is_that_of_the_chunks_at_hand(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """At most what is estimated for one group and the buffers of files, though the scene has 40 groups."""
    monkeypatch.setattr(reader, "GROUP_ANCHORS", 1024)
    trained = codec.parse((VECTORS / "valid" / "trained-snowmiku.c3gs").read_bytes()).scene
    rows = np.resize(np.arange(trained.anchor_count), 40 * 1024)
    data = codec.emit(replace(take_anchors(trained, rows), chunk_size=256, position_model=None))
    (tmp_path / "file").write_bytes(data)
    bound = memory_needed(codec.parse_container(data), 1024) + BUFFERS

    def most(way: Any) -> int:
        tracemalloc.start()
        try:
            way()
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    with (tmp_path / "file").open("rb") as file:

        def streamed() -> None:
            decode_folder(Reader(StoredFile(file)).open(), tmp_path / "scene")

        def chunks() -> None:
            for _ in decoded_chunks(StoredFile(file)):
                pass

        streamed()
        assert most(streamed) < bound
        assert most(chunks) < bound
    assert most(lambda: codec.parse(data)) > bound


# --- bytes ------------------------------------------------------------------------------------------------------------


def test_a_stored_file_is_read_as_it_is_asked_for(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(bytes(range(100)))
    with (tmp_path / "file").open("rb") as file:
        source = StoredFile(file)
        assert source.length() == 100
        assert source.read(10, 3) == b"\x0a\x0b\x0c"
        assert source.read(98, 1 << 60) == b"\x62\x63"
        assert source.read(100, 1) == source.read(1 << 60, 5) == b""
        every = FileBytes(source)
        assert len(every) == 100
        assert every[97:] == b"abc"
        assert every[:2] == b"\0\1"
        assert every[5:5] == every[7:5] == b""
    with (tmp_path / "file").open("rb", buffering=0) as unbuffered:
        every = FileBytes(StoredFile(unbuffered))
        os.truncate(tmp_path / "file", 50)
        assert every[48:52] == b"\x30\x31\0\0"
