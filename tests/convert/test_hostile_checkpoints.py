"""Damaged or hostile model folders: one line each, no code is run, and memory is bounded."""

import io
import json
import os
import pickle
import random
import tracemalloc
import zipfile
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("scipy")

from family import LAYOUTS, Model  # noqa: E402

from refcodec.cli.main import main  # noqa: E402
from refcodec.convert.tensors import read_state_dicts, read_torchscript  # noqa: E402
from refcodec.folder.layout import SceneFolderError  # noqa: E402

Captured = pytest.CaptureFixture[str]
# Changes a file of networks. The second argument is the folder that hostile code would make.
Harm = Callable[[Path, Path], Any]
PLACE = Path("point_cloud", "iteration_30000")
UNITED, SPLIT = LAYOUTS["hac"], LAYOUTS["scaffold, split"]
# The layouts, each with a file of its networks.
BOTH = pytest.mark.parametrize(("layout", "name"), [(UNITED, "checkpoint.pth"), (SPLIT, "cov_mlp.pt")])
# The bytes that a file may make Python allocate.
MEMORY = 24 << 20
READERS: dict[Any, Callable[[Path], Any]] = {
    UNITED: lambda file: read_state_dicts(file, ("opacity_mlp", "cov_mlp")),
    SPLIT: read_torchscript,
}


def assert_refused(folder: Path, capsys: Captured, *reasons: str) -> None:
    """convert of the folder `model` ends with one line that has the reasons. It writes nothing, and runs nothing."""
    capsys.readouterr()
    assert main(["convert", str(folder / "model"), "-o", str(folder / "scene")]) == 64
    err = capsys.readouterr().err
    assert err.count("\n") == 1, err
    assert all(reason in err for reason in reasons), err
    assert not (folder / "scene").exists()
    assert not (folder / "run").exists()


def refusal(read: Callable[[Path], Any], file: Path) -> str:
    """Returns the line with which a reader refuses a file, in bounded memory; empty if it reads the file."""
    tracemalloc.start()
    try:
        read(file)
    except SceneFolderError as error:
        return str(error)
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < MEMORY
    return ""


class Called:
    """A pickle of it calls a function when it is loaded: with `run`, to make this folder; else, to take a terabyte."""

    def __init__(self, run: Path | None) -> None:
        self.run = run

    def __reduce__(self) -> tuple[Any, ...]:
        return (os.mkdir, (str(self.run),)) if self.run else (bytearray, (1 << 40,))


def repacked(file: Path, changes: dict[str, bytes], form: int = zipfile.ZIP_STORED) -> None:
    """Changes entries of an archive. form: of the changed ones."""
    with zipfile.ZipFile(file) as archive:
        entries = {entry.filename: (archive.read(entry), entry.compress_type) for entry in archive.infolist()}
    with zipfile.ZipFile(file, "w") as archive:
        for name, (data, kind) in entries.items():
            inner = name.partition("/")[2]
            archive.writestr(name, changes.get(inner, data), form if inner in changes else kind)


# --- archives and pickles, in both layouts ----------------------------------------------------------------------------


def replaced(data: bytes | Callable[[Path], bytes], entry: str = "data.pkl", form: int = zipfile.ZIP_STORED) -> Harm:
    """A change of an entry. data: its new bytes, or a function of the folder that returns them."""
    return lambda file, run: repacked(file, {entry: data if isinstance(data, bytes) else data(run)}, form)


def twice(file: Path, run: Path) -> None:
    """One of two entries of a name could be looked at, and the other loaded."""
    with zipfile.ZipFile(file, "a") as archive:
        name = next(entry.filename for entry in archive.infolist() if entry.filename.endswith("/data.pkl"))
        with pytest.warns(UserWarning, match="Duplicate"):
            archive.writestr(name, pickle.dumps(Called(run), 2))


def many_entries(file: Path, run: Path) -> None:
    """The directory alone would take some fifty megabytes."""
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("a", b"")
    data, count = file.read_bytes(), 60_000
    start, end = data.index(b"PK\x01\x02"), data.index(b"PK\x05\x06")
    tail = bytearray(data[end:])
    tail[8:12] = count.to_bytes(2, "little") * 2
    tail[12:16] = (count * (end - start)).to_bytes(4, "little")
    file.write_bytes(data[:start] + count * data[start:end] + tail)


BOMB = bytes(200 << 20)
# A change of a file of networks, and the reason of the refusal.
HARMS: dict[str, tuple[Harm, str]] = {
    "code 0": (replaced(lambda run: pickle.dumps(Called(run), 0)), "its pickle"),
    "code 2": (
        replaced(lambda run: pickle.dumps(Called(run), 2)),
        "its pickle names posix mkdir, which is not a tensor: nothing of it was run",
    ),
    "code 4": (replaced(lambda run: pickle.dumps(Called(run), 4)), "its pickle"),
    # As torch wrote before 1.6.
    "a plain pickle": (lambda file, run: file.write_bytes(pickle.dumps(Called(run))), "not a zip archive"),
    "code by torch": (lambda file, run: torch.save({"cov_mlp": Called(run)}, file), "its pickle names posix mkdir"),
    "memory": (lambda file, run: torch.save(Called(None), file), "names"),
    "memory of a network": (lambda file, run: torch.save({"opacity_mlp": Called(None)}, file), "names"),
    "a bomb for a pickle": (replaced(BOMB, "data.pkl", zipfile.ZIP_DEFLATED), "is compressed"),
    "a bomb for a tensor": (replaced(BOMB, "data/0", zipfile.ZIP_DEFLATED), "is compressed"),
    "big endian": (replaced(b"big", "byteorder"), "little-endian"),
    "twice": (twice, "two of its entries have the same name"),
    "many entries": (many_entries, "directory has more than"),
}


@BOTH
@pytest.mark.parametrize("harm", HARMS)
def test_harm(layout: Any, name: str, harm: str, tmp_path: Path, capsys: Captured) -> None:
    file = Model(layout).write(tmp_path / "model") / name
    change, reason = HARMS[harm]
    change(file, tmp_path / "run")
    assert_refused(tmp_path, capsys, name, reason)
    assert reason in refusal(READERS[layout], file)


def test_code_of_a_script_is_not_run(tmp_path: Path) -> None:
    """What an archive's code says does not matter."""
    model = Model(SPLIT)
    file = model.write(tmp_path / "model") / "opacity_mlp.pt"
    for _ in range(2):
        read = read_torchscript(file)
        assert set(read) == {"0.weight", "0.bias", "2.weight", "2.bias"}
        for name, values in model.networks["opacity_mlp"].float().state_dict().items():
            assert np.array_equal(read[name], values.numpy())
        repacked(file, {"code/__torch__/torch/nn/modules/linear.py": b"import os; os.mkdir('run')"})


# --- pickles by themselves --------------------------------------------------------------------------------------------

INT, FLOATS = b"K\x01", b"(X\x07\x00\x00\x00storagectorch\nFloatStorage\nX\x01\x00\x00\x000X\x03\x00\x00\x00cpuK\x01tQ"
MODULE, REBUILD = b"c__torch__\nModule\n", b"ctorch._utils\n_rebuild_tensor_v2\n"
LARGE = b"\x8a\xfe" + b"\xff" * 253 + b"\x00"
STATE = b"}q\x01(" + b"".join(b"J" + i.to_bytes(4, "little") + b"N" for i in range(9000)) + b"u"
LONG_NAME = b")\x81}(X" + (1 << 19).to_bytes(4, "little") + b"a" * (1 << 19)
FIELDS = b"".join(b"X\x01\x00\x00\x00" + bytes([97 + i]) + b"h\x01" for i in range(20))
STORAGE = b"(X\x07\x00\x00\x00storagectorch\n" + b"x" * 100_000 + b"\nX\x01\x00\x00\x000X\x03\x00\x00\x00cpuK\x01tq\x05"
# A tuple of tuples of tuples, each twice the one before. To hash or show it takes forever.
DOUBLED = b")" + b"q\x00h\x00\x86" * 80
# Tuples in each other, deeper than Python's stack.
DEEP = b")" + b"\x85" * 100_000


def rebuilt(shape: bytes, offset: bytes = INT) -> bytes:
    """A pickle of one tensor, whose strides are its sides."""
    return REBUILD + b"(" + FLOATS + offset + shape + b"q\x01h\x01tR"


# Opcodes, the refusal by the reader of scripts, and whether that of state dicts refuses them so, too.
PICKLES: dict[str, tuple[bytes, str, bool]] = {
    "a key": (b"}" + DOUBLED + b"K\x01s", "its pickle", True),
    "a built key": (b"}}" + DOUBLED + b"K\x01sb", "its pickle", True),
    "a function": (DOUBLED + b")R", "its pickle", True),
    "a shape": (REBUILD + b"(" + DOUBLED + b"h\x00h\x00h\x00tR", "its pickle", True),
    "a deep key": (b"}" + DEEP + b"K\x01s", "its pickle", True),
    "a deep function": (DEEP + b")R", "its pickle", True),
    # One number of 2,032 bits stands for many sides, whose product grows with each.
    "sides": (rebuilt(b"(" + LARGE + b"q\x02" + b"h\x02" * 4000 + b"t"), "damaged", True),
    "side": (rebuilt(b"(" + LARGE + b"t"), "damaged", True),
    "offset": (rebuilt(b"(K\x01t", offset=LARGE), "damaged", True),
    "dimensions": (rebuilt(b"(" + INT * 70 + b"t"), "70 dimensions, but at most 5", True),
    # One shape of many sides stands for those of many tensors.
    "shapes": (b"(" + INT * 20_000 + b"tq\x07" + rebuilt(b"h\x07") * 4000, "20000 dimensions", True),
    # One state is put into one list again and again.
    "states": (STATE + b"]" + b"h\x01b" * 9000, "damaged", True),
    # Names of parts are joined. A long one would be joined with each of thousands.
    "long names": (MODULE + LONG_NAME + b"}(X\x01\x00\x00\x00b}uub", "a name of more than 256 characters", False),
    # Fields can be each other's. They are looked at a bounded number of times.
    "itself": (MODULE + b"q\x00)\x81q\x01}(" + FIELDS + b"ub", "more than 4096 fields", False),
    # Each mark takes nothing of what is below it. The name of a storage is as long as the pickle allows.
    "marks": (b"N" * 100_000 + b"(t" * 100_000 + b"}", "", True),
    "names": (STORAGE + b"h\x05Q" * 100_000 + b"}", "", False),
}


@pytest.mark.parametrize("name", PICKLES)
def test_pickles_are_bounded(name: str, tmp_path: Path) -> None:
    opcodes, reason, both = PICKLES[name]
    with zipfile.ZipFile(tmp_path / "a.pt", "w") as archive:
        archive.writestr("a/data.pkl", b"\x80\x02" + opcodes + b".")
    for layout in (SPLIT, UNITED) if both else (SPLIT,):
        line = refusal(READERS[layout], tmp_path / "a.pt")
        assert reason in line
        assert bool(line) == bool(reason)


# --- what is wrong with a model ---------------------------------------------------------------------------------------


def layers(name: str, *sizes: int) -> Callable[[Model], None]:
    """Replaces a network by linear layers of some sizes, with ReLU between them."""

    def change(model: Model) -> None:
        linear = [torch.nn.Linear(*pair) for pair in pairwise(sizes)]
        model.networks[name] = torch.nn.Sequential(*[part for each in linear for part in (each, torch.nn.ReLU())][:-1])

    return change


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda model: model.anchor.__setitem__((3, 1), np.nan), "a value of xyz is NaN"),
        (lambda model: model.scaling.__setitem__((0, 5), np.inf), "a value of scale_ is NaN or infinite"),
        (lambda model: model.networks["cov_mlp"][0].weight.data.fill_(torch.nan), "cov_mlp.0 has a number that is NaN"),
        (layers("cov_mlp", 54, 50, 70, 70), "cov_mlp is not a network of two linear layers"),
        (layers("opacity_mlp", 30, 50, 10), "opacity_mlp has 30 inputs; it must have 53"),
        (layers("color_mlp", 54, 50, 29), "color_mlp.2 has the shapes (29, 50)"),
        (layers("opacity_mlp", 54, 200, 10), "200 hidden units, but at most 128"),
    ],
)
def test_wrong_numbers_and_shapes(
    change: Callable[[Model], None], reason: str, tmp_path: Path, capsys: Captured
) -> None:
    model = Model(UNITED)
    change(model)
    model.write(tmp_path / "model")
    assert_refused(tmp_path, capsys, reason)


def first_weight(weight: Any) -> Callable[[dict[str, Any]], Any]:
    return lambda states: states["opacity_mlp"].__setitem__("0.weight", weight)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        *((lambda states, name=name: states.pop(name), f"no network {name}") for name in Model(UNITED).networks),
        (lambda states: states.update(mlp_feature_bank={}), "feature bank, which mixes features by view"),
        (lambda states: states.update(opacity_mlp=[]), "opacity_mlp. does not have at most 8 tensors"),
        (lambda states: states.update(opacity_mlp={str(i): torch.ones(1) for i in range(9)}), "at most 8 tensors"),
        # One number stands for 2^40 of them.
        (first_weight(torch.zeros(1).expand(1 << 20, 1 << 20)), "opacity_mlp.0.weight is not a dense tensor of floats"),
        (first_weight(torch.zeros(9, 9).T), "opacity_mlp.0.weight is not a dense tensor of floats"),
        (first_weight(torch.zeros(9, 9, dtype=torch.int)), "opacity_mlp.0.weight is not a dense tensor of floats"),
        (first_weight(7), "opacity_mlp.0.weight is not a dense tensor of floats"),
    ],
)
def test_state_dicts(change: Callable[[dict[str, Any]], Any], reason: str, tmp_path: Path, capsys: Captured) -> None:
    model = Model(UNITED)
    place, states = model.write(tmp_path / "model"), model.state_dicts()
    change(states)
    torch.save(states, place / "checkpoint.pth")
    assert_refused(tmp_path, capsys, reason)


@pytest.mark.parametrize("kind", [torch.float16, torch.bfloat16, torch.float64])
def test_other_floats(kind: Any, tmp_path: Path) -> None:
    values = torch.linspace(-3, 3, 30, dtype=torch.float32).reshape(5, 6)
    torch.save({"cov_mlp": {"0.weight": values.to(kind), "empty": values[:0]}}, tmp_path / "a.pth")
    tensors = read_state_dicts(tmp_path / "a.pth", ("cov_mlp",))["cov_mlp"]
    assert np.array_equal(tensors["0.weight"], values.to(kind).float().numpy())
    assert tensors["empty"].shape == (0, 6)


def ply(*lines: str) -> bytes:
    return "\n".join(["ply", "format binary_little_endian 1.0", *lines, "end_header", ""]).encode()


def other_camera(**change: Any) -> bytes:
    camera = {"id": 0, "img_name": "a", "width": 64, "height": 48, "fx": 60.0, "fy": 61.0, "position": [1, -9, 2]}
    camera["rotation"] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
    return json.dumps([camera, camera | change]).encode()


CLOUD = PLACE / "point_cloud.ply"
# A file, its bytes (None for none), and the reason of the refusal besides the file's name.
CONTENTS: list[tuple[Path | str, bytes | None, str]] = [
    (CLOUD, None, "the file does not exist"),
    (CLOUD, ply(f"element vertex {1 << 40}", "property float x"), "count"),
    (CLOUD, ply(f"element vertex {1 << 31}", "property float x"), "fewer bytes"),
    (CLOUD, ply("element vertex 0", "property float x"), "1 properties xyz"),
    (CLOUD, ply("element vertex 0", "property float x", "property float level"), "levels of detail"),
    (CLOUD, b"", "no end"),
    (CLOUD, b"\x80\x02.", "PLY"),
    (PLACE / "checkpoint.pth", None, "neither checkpoint.pth nor"),
    *(("cfg_args", text, "") for text in (b"", b"__import__('os').mkdir('run')", b"Namespace(" + b"(" * 100_000)),
    ("cfg_args", b"Namespace(feat_dim=49, x=1)", "50 features, but cfg_args states 49"),
    ("cfg_args", b"\xff" * 99, "not a text Namespace"),
    ("cfg_args", b"Namespace(use_feat_bank=True)", "feature bank"),
    *(
        ("cameras.json", text, "not JSON")
        for text in (b"[" * 1000, b"[NaN]", b"[{}", b"\xff", b'[{"a": 1, "a": 2}]', b"")
    ),
    *(("cameras.json", text, "a list is required") for text in (b"{}", b"null", b"7", b'"a"')),
    *(("cameras.json", text, "[0] in its text is") for text in (b"[null]", b"[[]]")),
    ("cameras.json", b"[{}]", "[0]/width in its text is missing"),
    *(("cameras.json", other_camera(width=width), "[1]/width") for width in (0, True, "64", None, [64], 1e30)),
    *(("cameras.json", other_camera(fx=fx), "[1]/fx") for fx in ("x", {}, 10**39)),
    *(("cameras.json", other_camera(fy=fy), "[1]/fy") for fy in (-1, 0)),
    ("cameras.json", other_camera(rotation=[[1, 0, 0]] * 3), "[1] has a matrix that is not a rotation"),
    ("cameras.json", other_camera(rotation=[[1, 0, 0], [0, 1, 0], [0, 0, -1]]), "[1] has a matrix that is not"),
    *(("cameras.json", other_camera(rotation=r), "[1]/rotation") for r in ("identity", [1, 0, 0], [["1"] * 3] * 3)),
    *(("cameras.json", other_camera(position=p), "[1]/position") for p in ([1, 2], [1, 2, [3]], [1, 2, "3"], {"x": 1})),
]


@pytest.mark.parametrize(("name", "data", "reason"), CONTENTS, ids=range(len(CONTENTS)))
def test_contents(name: Path | str, data: bytes | None, reason: str, tmp_path: Path, capsys: Captured) -> None:
    Model(UNITED).write(tmp_path / "model")
    (tmp_path / "model" / name).unlink()
    if data is not None:
        (tmp_path / "model" / name).write_bytes(data)
    assert_refused(tmp_path, capsys, Path(name).name, reason)


def test_a_point_cloud_with_holes(tmp_path: Path, capsys: Captured) -> None:
    """A file system can say that a file has terabytes, of which none are on the disk."""
    Model(UNITED).write(tmp_path / "model")
    file = tmp_path / "model" / CLOUD
    head, body = file.read_bytes().split(b"end_header\n")
    file.write_bytes(head.replace(b"f_anchor_feat_", b"f_other_value_") + b"end_header\n" + body)
    assert_refused(tmp_path, capsys, "no properties f_anchor_feat_")
    lines = head.splitlines()
    file.write_bytes(b"\n".join([*lines[:2], b"element vertex 1073741824", *lines[3:], b"end_header", b""]))
    try:
        os.truncate(file, 1 << 39)
    except OSError:
        pytest.skip("the file system has no files with holes")
    assert_refused(tmp_path, capsys, "1073741824 anchors, but at most 67108864")


@pytest.mark.parametrize("name", ["cfg_args", "cameras.json", CLOUD, PLACE / "checkpoint.pth"], ids=str)
def test_something_else_in_the_place_of_a_file(name: Path | str, tmp_path: Path, capsys: Captured) -> None:
    """A folder, a link that leads nowhere, and a pipe, which would be waited for."""
    Model(UNITED).write(tmp_path / "model")
    path = tmp_path / "model" / name
    path.unlink()
    path.mkdir()
    assert_refused(tmp_path, capsys, "a directory")
    path.rmdir()
    path.symlink_to("nowhere")
    assert_refused(tmp_path, capsys, "leads nowhere")
    path.unlink()
    os.mkfifo(path)
    assert_refused(tmp_path, capsys, "a pipe")


def test_folders_without_a_model(tmp_path: Path, capsys: Captured) -> None:
    assert_refused(tmp_path, capsys, "does not exist")
    (tmp_path / "model").mkdir()
    assert_refused(tmp_path, capsys, "neither point_cloud.ply nor point_cloud/iteration_N")
    place = Model(SPLIT).write(tmp_path / "model" / "other")
    (place / "cov_mlp.pt").unlink()
    (tmp_path / "model" / "point_cloud").symlink_to(place.parent)
    assert_refused(tmp_path, capsys, "no network cov_mlp")


# --- damage -----------------------------------------------------------------------------------------------------------


@BOTH
def test_cut_and_changed_files_are_read_or_refused(layout: Any, name: str, tmp_path: Path) -> None:
    """Whatever the bytes are, the outcome is tensors or one SceneFolderError."""
    file = Model(layout).write(tmp_path / "model") / name
    whole, rng = file.read_bytes(), random.Random(5)
    with zipfile.ZipFile(io.BytesIO(whole)) as archive:
        (entry,) = (e for e in archive.infolist() if e.filename.endswith("/data.pkl"))
        pickle_of = archive.read(entry)

    def changed(data: bytes, places: Callable[[], int]) -> bytes:
        some = bytearray(data)
        for _ in range(rng.randrange(1, 4)):
            some[places()] = rng.randrange(256)
        return bytes(some)

    def place() -> int:
        """Most damage is in the pickle and the directory, since tensors may hold anything."""
        inside = entry.header_offset + rng.randrange(entry.file_size + 60)
        return rng.choice([inside, len(whole) - 1 - rng.randrange(600)])

    damaged = [whole[: rng.randrange(len(whole))] for _ in range(20)] + [changed(whole, place) for _ in range(80)]
    lines = []
    for data in damaged:
        file.write_bytes(data)
        lines.append(refusal(READERS[layout], file))
    assert any(lines)
    # A pickle that is changed, with the sum of the entry set right.
    for _ in range(150):
        file.write_bytes(whole)
        repacked(file, {"data.pkl": changed(pickle_of, lambda: rng.randrange(len(pickle_of)))})
        refusal(READERS[layout], file)
