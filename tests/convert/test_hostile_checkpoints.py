"""Damaged or hostile model folders: one line each, no code is run, and memory is bounded."""

from __future__ import annotations

import io
import json
import os
import pickle
import random
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
from memory import bounded  # noqa: E402

from refcodec.cli.main import main  # noqa: E402
from refcodec.convert.tensors import read_state_dicts, read_torchscript  # noqa: E402
from refcodec.folder.layout import SceneFolderError  # noqa: E402

Captured = pytest.CaptureFixture[str]
PLACE = "model/point_cloud/iteration_30000"
UNITED, SPLIT = LAYOUTS["hac"], LAYOUTS["scaffold, split"]
BOTH = pytest.mark.parametrize(("layout", "name"), [(UNITED, "checkpoint.pth"), (SPLIT, "cov_mlp.pt")])


def refused(tmp_path: Path, capsys: Captured, *said: str) -> None:
    """convert of the folder `model` ends with one line, which says so, and writes nothing."""
    capsys.readouterr()
    assert main(["convert", str(tmp_path / "model"), "-o", str(tmp_path / "scene")]) == 64
    err = capsys.readouterr().err
    assert err.count("\n") == 1, err
    for words in said:
        assert words in err
    assert not (tmp_path / "scene").exists()
    assert not (tmp_path / "run").exists()


class Harm:
    """A pickle of it makes the folder `run` when it is loaded."""

    def __init__(self, place: Path) -> None:
        self.place = place

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (str(self.place),)


class Large:
    """A pickle of it takes a terabyte when it is loaded."""

    def __reduce__(self) -> tuple[Any, ...]:
        return bytearray, (1 << 40,)


def archived(file: Path, pickled: bytes) -> None:
    """Writes an archive of a pickle."""
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("a/data.pkl", pickled)


def repacked(file: Path, changes: dict[str, bytes], form: int = zipfile.ZIP_STORED) -> None:
    """Changes entries of an archive. form: of the changed ones."""
    with zipfile.ZipFile(file) as archive:
        entries = {entry.filename: (archive.read(entry), entry.compress_type) for entry in archive.infolist()}
    with zipfile.ZipFile(file, "w") as archive:
        for name, (data, kind) in entries.items():
            inner = name.partition("/")[2]
            archive.writestr(name, changes.get(inner, data), form if inner in changes else kind)


# --- code -------------------------------------------------------------------------------------------------------------


@BOTH
@pytest.mark.parametrize("protocol", [0, 2, 4])
def test_a_pickle_with_code_is_not_run(layout: Any, name: str, protocol: int, tmp_path: Path, capsys: Captured) -> None:
    Model(layout).write(tmp_path / "model")
    file, harm = tmp_path / PLACE / name, pickle.dumps(Harm(tmp_path / "run"), protocol)
    repacked(file, {"data.pkl": harm})
    refused(tmp_path, capsys, name, "its pickle")
    if protocol == 2:
        refused(tmp_path, capsys, "posix mkdir", "nothing of it was run")
    # A plain pickle, as torch wrote before 1.6.
    file.write_bytes(harm)
    refused(tmp_path, capsys, "not a zip archive")
    # As torch.save writes such an object.
    torch.save({"opacity_mlp": Harm(tmp_path / "run")}, file)
    refused(tmp_path, capsys, "its pickle names posix mkdir")


def test_code_of_a_script_is_not_run(tmp_path: Path) -> None:
    """What an archive's code says does not matter, nor what it is compressed with."""
    model = Model(SPLIT)
    place = model.write(tmp_path / "model")
    before = read_torchscript(place / "opacity_mlp.pt")
    repacked(place / "opacity_mlp.pt", {"code/__torch__/torch/nn/modules/linear.py": b"import os; os.mkdir('run')"})
    after = read_torchscript(place / "opacity_mlp.pt")
    assert set(before) == {"0.weight", "0.bias", "2.weight", "2.bias"}
    for name, values in model.networks["opacity_mlp"].float().state_dict().items():
        assert np.array_equal(before[name], values.numpy())
        assert np.array_equal(after[name], values.numpy())


@pytest.mark.parametrize("large", [Large(), {"opacity_mlp": Large()}])
def test_a_pickle_takes_no_memory(large: Any, tmp_path: Path, capsys: Captured) -> None:
    Model(UNITED).write(tmp_path / "model")
    torch.save(large, tmp_path / PLACE / "checkpoint.pth")
    refused(tmp_path, capsys, "names")


# --- sizes ------------------------------------------------------------------------------------------------------------


@BOTH
@pytest.mark.parametrize("entry", ["data.pkl", "data/0"])
def test_a_zip_bomb_is_not_unpacked(layout: Any, name: str, entry: str, tmp_path: Path, capsys: Captured) -> None:
    Model(layout).write(tmp_path / "model")
    repacked(tmp_path / PLACE / name, {entry: bytes(200 << 20)}, zipfile.ZIP_DEFLATED)
    # The first run imports what it needs.
    refused(tmp_path, capsys, "is compressed")
    with bounded(20):
        refused(tmp_path, capsys, "is compressed")


@pytest.mark.parametrize("stride", [(0, 0), (1, 1)])
def test_a_tensor_larger_than_its_bytes(stride: tuple[int, int], tmp_path: Path, capsys: Captured) -> None:
    """One number stands for 2^40 of them."""
    model = Model(UNITED)
    model.write(tmp_path / "model")
    found: dict[str, Any] = model.state_dicts()
    one = torch.zeros(1 << 10).as_strided((1 << 5, 1 << 5), stride).expand(1 << 5, 1 << 5)
    found["opacity_mlp"]["0.weight"] = one if stride[0] else torch.zeros(1).expand(1 << 20, 1 << 20)
    torch.save(found, tmp_path / PLACE / "checkpoint.pth")
    refused(tmp_path, capsys, "opacity_mlp.0.weight is not a dense tensor of floats")


def doubled(times: int) -> bytes:
    """Opcodes that leave a tuple of tuples of tuples, each twice the one before. To hash or show it takes forever."""
    return b")" + b"q\x00h\x00\x86" * times


@BOTH
@pytest.mark.parametrize(
    "opcodes",
    [
        # As a key, as a key of a built object, as a function, as a tensor's shape.
        b"}" + doubled(80) + b"K\x01s.",
        b"}}" + doubled(80) + b"K\x01sb.",
        doubled(80) + b")R.",
        b"ctorch._utils\n_rebuild_tensor_v2\n(" + doubled(80) + b"h\x00h\x00h\x00tR.",
        # Deeper than Python's stack.
        b"}" + b")" + b"\x85" * 100_000 + b"K\x01s.",
        b")" + b"\x85" * 100_000 + b")R.",
    ],
    ids=["key", "built", "function", "shape", "deep key", "deep function"],
)
def test_a_pickle_of_tuples_of_tuples(layout: Any, name: str, opcodes: bytes, tmp_path: Path, capsys: Captured) -> None:
    Model(layout).write(tmp_path / "model")
    repacked(tmp_path / PLACE / name, {"data.pkl": b"\x80\x02" + opcodes})
    refused(tmp_path, capsys, "its pickle")


@BOTH
def test_two_entries_of_one_name(layout: Any, name: str, tmp_path: Path, capsys: Captured) -> None:
    """Which one is read depends on the reader, so that one could be looked at, and the other loaded."""
    Model(layout).write(tmp_path / "model")
    with zipfile.ZipFile(tmp_path / PLACE / name, "a") as archive:
        pickled = next(entry.filename for entry in archive.infolist() if entry.filename.endswith("/data.pkl"))
        with pytest.warns(UserWarning, match="Duplicate"):
            archive.writestr(pickled, pickle.dumps(Harm(tmp_path / "run"), 2))
    refused(tmp_path, capsys, "two of its entries have the same name")


@BOTH
def test_an_archive_of_many_entries(layout: Any, name: str, tmp_path: Path, capsys: Captured) -> None:
    """The directory alone would take some fifty megabytes."""
    Model(layout).write(tmp_path / "model")
    file = tmp_path / PLACE / name
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("a", b"")
    data = file.read_bytes()
    start, count = data.index(b"PK\x01\x02"), 60_000
    entry, end = data[start : data.index(b"PK\x05\x06")], bytearray(data[data.index(b"PK\x05\x06") :])
    end[8:12] = count.to_bytes(2, "little") * 2
    end[12:16] = (count * len(entry)).to_bytes(4, "little")
    file.write_bytes(data[:start] + count * entry + end)
    # The first run imports what it needs.
    refused(tmp_path, capsys, "directory has more than")
    with bounded(16):
        refused(tmp_path, capsys, "directory has more than")


def test_a_module_of_long_names(tmp_path: Path) -> None:
    """Names of parts are joined. A long one would be joined with each of thousands."""
    field = b"X" + (1 << 19).to_bytes(4, "little") + b"a" * (1 << 19)
    data = b"\x80\x02c__torch__\nModule\n)\x81}(" + field + b"}(X\x01\x00\x00\x00b}uub."
    archived(tmp_path / "a.pt", data)
    with pytest.raises(SceneFolderError, match="a name of more than 256 characters"):
        read_torchscript(tmp_path / "a.pt")


def test_a_point_cloud_with_holes(tmp_path: Path, capsys: Captured) -> None:
    """A file system can say that a file has terabytes, of which none are on the disk."""
    Model(UNITED).write(tmp_path / "model")
    file = tmp_path / PLACE / "point_cloud.ply"
    names = [line.split()[-1].decode() for line in file.read_bytes().split(b"end_header")[0].splitlines()[3:]]
    file.write_bytes(ply(f"element vertex {1 << 30}", *(f"property float {name}" for name in names)))
    try:
        os.truncate(file, 1 << 39)
    except OSError:
        pytest.skip("the file system has no files with holes")
    refused(tmp_path, capsys, "1073741824 anchors, but at most 67108864")


def test_a_module_that_holds_itself(tmp_path: Path) -> None:
    """Fields can be each other's. They are looked at a bounded number of times."""
    data = (
        b"\x80\x02ctorch Module\nq\x00)\x81q\x01}(".replace(b"torch Module", b"__torch__\nModule")
        + b"".join(b"X\x01\x00\x00\x00" + bytes([97 + i]) + b"h\x01" for i in range(20))
        + b"ub."
    )
    archived(tmp_path / "a.pt", data)
    with pytest.raises(SceneFolderError, match="more than 4096 fields"):
        read_torchscript(tmp_path / "a.pt")


INT, FLOATS = b"K\x01", b"(X\x07\x00\x00\x00storagectorch\nFloatStorage\nX\x01\x00\x00\x000X\x03\x00\x00\x00cpuK\x01tQ"
REBUILD = b"ctorch._utils\n_rebuild_tensor_v2\n"
STATE = b"}q\x01(" + b"".join(b"J" + i.to_bytes(4, "little") + b"N" for i in range(9000)) + b"u"
LARGE = b"\x8a\xfe" + b"\xff" * 253 + b"\x00"


def rebuilt(shape: bytes, offset: bytes = INT) -> bytes:
    """A pickle of one tensor, whose strides are its sides."""
    return REBUILD + b"(" + FLOATS + offset + shape + b"q\x01h\x01tR"


@pytest.mark.parametrize(
    ("pickled", "said"),
    [
        # One number of 2,032 bits stands for many sides, whose product grows with each.
        (rebuilt(b"(" + LARGE + b"q\x02" + b"h\x02" * 4000 + b"t"), "damaged"),
        (rebuilt(b"(" + LARGE + b"t"), "damaged"),
        (rebuilt(b"(K\x01t", offset=LARGE), "damaged"),
        (rebuilt(b"(" + INT * 70 + b"t"), "70 dimensions, but at most 5"),
        # One shape of many sides stands for those of many tensors.
        (
            b"(" + INT * 20_000 + b"tq\x07" + (REBUILD + b"(" + FLOATS + INT + b"h\x07h\x07tR") * 4000,
            "20000 dimensions",
        ),
        # One state is put into one list again and again.
        (
            b"}q\x01("
            + b"".join(b"J" + i.to_bytes(4, "little") + b"N" for i in range(9000))
            + b"u]"
            + b"h\x01b" * 9000,
            "damaged",
        ),
    ],
    ids=["sides", "side", "offset", "dimensions", "shapes", "states"],
)
def test_numbers_of_a_pickle_are_bounded(pickled: bytes, said: str, tmp_path: Path) -> None:
    archived(tmp_path / "a.pt", b"\x80\x02" + pickled + b".")
    # The module may be imported here.
    for read in (read_torchscript, lambda file: read_state_dicts(file, ())):
        with pytest.raises(SceneFolderError, match=said):
            read(tmp_path / "a.pt")
        with bounded(24), pytest.raises(SceneFolderError, match=said):
            read(tmp_path / "a.pt")


@pytest.mark.parametrize(
    "pickled",
    [
        # Each mark takes nothing of what is below it.
        b"N" * 100_000 + b"(t" * 100_000 + b"}",
        # The name of a storage is as long as the pickle allows.
        b"(X\x07\x00\x00\x00storagectorch\n"
        + b"x" * 100_000
        + b"\nX\x01\x00\x00\x000X\x03\x00\x00\x00cpuK\x01tq\x05"
        + b"h\x05Q" * 100_000
        + b"}",
    ],
    ids=["marks", "names"],
)
def test_opcodes_cost_no_more_than_their_bytes(pickled: bytes, tmp_path: Path) -> None:
    archived(tmp_path / "a.pt", b"\x80\x02" + pickled + b".")
    with bounded(32):
        assert read_torchscript(tmp_path / "a.pt") == {}


def ply(*lines: str) -> bytes:
    return "\n".join(["ply", "format binary_little_endian 1.0", *lines, "end_header", ""]).encode()


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (ply(f"element vertex {1 << 40}", "property float x"), "count"),
        (ply(f"element vertex {1 << 31}", "property float x"), "fewer bytes"),
        (ply("element vertex 0", "property float x"), "1 properties xyz"),
        (b"", "no end"),
        (b"\x80\x02.", "PLY"),
    ],
)
def test_point_clouds(data: bytes, said: str, tmp_path: Path, capsys: Captured) -> None:
    Model(UNITED).write(tmp_path / "model")
    (tmp_path / PLACE / "point_cloud.ply").write_bytes(data)
    refused(tmp_path, capsys, "point_cloud.ply", said)


# --- what is wrong with a model ---------------------------------------------------------------------------------------


def _layers(name: str, *sizes: int) -> Callable[[Model], None]:
    """Replaces a network by linear layers of some sizes, with ReLU between them."""

    def change(model: Model) -> None:
        layers = [torch.nn.Linear(*pair) for pair in pairwise(sizes)]
        model.networks[name] = torch.nn.Sequential(*[part for each in layers for part in (each, torch.nn.ReLU())][:-1])

    return change


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda model: model.anchor.__setitem__((3, 1), np.nan), "a value of xyz is NaN"),
        (lambda model: model.scaling.__setitem__((0, 5), np.inf), "a value of scale_ is NaN or infinite"),
        (lambda model: model.networks["cov_mlp"][0].weight.data.fill_(torch.nan), "cov_mlp.0 has a number that is NaN"),
        (_layers("cov_mlp", 54, 50, 70, 70), "cov_mlp is not a network of two linear layers"),
        (_layers("opacity_mlp", 30, 50, 10), "opacity_mlp has 30 inputs; it must have 53"),
        (_layers("color_mlp", 54, 50, 29), "color_mlp.2 has the shapes (29, 50)"),
        (_layers("opacity_mlp", 54, 200, 10), "200 hidden units, but at most 128"),
    ],
)
def test_wrong_numbers_and_shapes(change: Callable[[Model], None], said: str, tmp_path: Path, capsys: Captured) -> None:
    model = Model(UNITED)
    change(model)
    model.write(tmp_path / "model")
    refused(tmp_path, capsys, said)


@pytest.mark.parametrize("name", ["opacity_mlp", "cov_mlp", "color_mlp"])
def test_a_network_is_missing(name: str, tmp_path: Path, capsys: Captured) -> None:
    for layout in (UNITED, SPLIT):
        folder = tmp_path / layout.form
        model = Model(layout)
        place = model.write(folder / "model")
        if layout is SPLIT:
            (place / f"{name}.pt").unlink()
        else:
            found = model.state_dicts()
            del found[name]
            torch.save(found, place / layout.form)
        refused(folder, capsys, f"no network {name}")


def test_what_the_format_cannot_express(tmp_path: Path, capsys: Captured) -> None:
    """A feature bank and levels of detail are named."""
    model = Model(UNITED)
    place = model.write(tmp_path / "model")
    torch.save(model.state_dicts() | {"mlp_feature_bank": {}}, place / "checkpoint.pth")
    refused(tmp_path, capsys, "feature bank", "cannot express it")
    torch.save(model.state_dicts(), place / "checkpoint.pth")
    notes = (tmp_path / "model" / "cfg_args").read_text()
    (tmp_path / "model" / "cfg_args").write_text(notes.replace("use_feat_bank=False", "use_feat_bank=True"))
    refused(tmp_path, capsys, "feature bank")
    (tmp_path / "model" / "cfg_args").write_text(notes)
    (place / "point_cloud.ply").write_bytes(ply("element vertex 0", "property float x", "property float level"))
    refused(tmp_path, capsys, "levels of detail")


def test_anchors_without_features(tmp_path: Path, capsys: Captured) -> None:
    Model(UNITED).write(tmp_path / "model")
    file = tmp_path / PLACE / "point_cloud.ply"
    file.write_bytes(file.read_bytes().replace(b"f_anchor_feat_", b"f_other_value_"))
    refused(tmp_path, capsys, "no properties f_anchor_feat_")


@pytest.mark.parametrize(
    "text",
    ["", "__import__('os').mkdir('run')", "Namespace(" + "(" * 100_000, "Namespace(feat_dim=49, x=1)", "\xff" * 99],
)
def test_settings_are_text(text: str, tmp_path: Path, capsys: Captured) -> None:
    Model(UNITED).write(tmp_path / "model")
    (tmp_path / "model" / "cfg_args").write_text(text)
    refused(tmp_path, capsys, "cfg_args")


@pytest.mark.parametrize(
    "change",
    [
        *({"width": 0}, {"width": True}, {"width": "64"}, {"width": None}, {"width": [64]}, {"height": 1e30}),
        *({"fx": "x"}, {"fx": {}}, {"fy": -1}, {"fy": 1e-400}, {"fx": 10**39}),
        *(
            {"rotation": [[1, 0, 0]] * 3},
            {"rotation": "identity"},
            {"rotation": [1, 0, 0]},
            {"rotation": [["1"] * 3] * 3},
        ),
        *({"position": [1, 2]}, {"position": [1, 2, [3]]}, {"position": [1, 2, "3"]}, {"position": {"x": 1}}),
    ],
    ids=str,
)
def test_cameras_are_checked(change: dict[str, Any], tmp_path: Path, capsys: Captured) -> None:
    Model(UNITED).write(tmp_path / "model")
    file = tmp_path / "model" / "cameras.json"
    (camera,) = json.loads(file.read_text())
    file.write_text(json.dumps([camera, camera | change]))
    refused(tmp_path, capsys, "cameras.json", "[1]")


@pytest.mark.parametrize(
    "text", ["[" * 1000, "{}", "null", "7", '"a"', "[null]", "[[]]", "[NaN]", "[{}", "\xff", '[{"id": 1, "id": 2}]', ""]
)
def test_cameras_are_a_list(text: str, tmp_path: Path, capsys: Captured) -> None:
    Model(UNITED).write(tmp_path / "model")
    (tmp_path / "model" / "cameras.json").write_text(text, encoding="latin-1")
    refused(tmp_path, capsys, "cameras.json")


@pytest.mark.parametrize(
    "name", ["cfg_args", "cameras.json", f"{PLACE[6:]}/point_cloud.ply", f"{PLACE[6:]}/checkpoint.pth"]
)
def test_something_else_in_the_place_of_a_file(name: str, tmp_path: Path, capsys: Captured) -> None:
    """A folder, a link that leads nowhere, and a pipe, which would be waited for."""
    Model(UNITED).write(tmp_path / "model")
    path = tmp_path / "model" / name
    path.unlink()
    path.mkdir()
    refused(tmp_path, capsys, "a directory")
    path.rmdir()
    path.symlink_to("nowhere")
    refused(tmp_path, capsys, "leads nowhere")
    path.unlink()
    os.mkfifo(path)
    refused(tmp_path, capsys, "a pipe")


def test_folders_without_a_model(tmp_path: Path, capsys: Captured) -> None:
    refused(tmp_path, capsys, "does not exist")
    (tmp_path / "model").mkdir()
    refused(tmp_path, capsys, "neither point_cloud.ply nor point_cloud/iteration_N")
    (tmp_path / PLACE).mkdir(parents=True)
    refused(tmp_path, capsys, "the file does not exist")
    Model(UNITED).write(tmp_path / "other")
    (tmp_path / "other" / "point_cloud" / "iteration_30000" / "point_cloud.ply").rename(
        tmp_path / PLACE / "point_cloud.ply"
    )
    refused(tmp_path, capsys, "neither checkpoint.pth nor")


# --- damage -----------------------------------------------------------------------------------------------------------


@BOTH
def test_cut_and_changed_files_are_read_or_refused(layout: Any, name: str, tmp_path: Path) -> None:
    """Whatever the bytes are, the outcome is tensors or one SceneFolderError."""
    file = Model(layout).write(tmp_path / "model") / name

    def read() -> None:
        if layout is UNITED:
            read_state_dicts(file, ("opacity_mlp", "cov_mlp"))
        else:
            read_torchscript(file)

    whole, rng = file.read_bytes(), random.Random(5)
    with zipfile.ZipFile(io.BytesIO(whole)) as archive:
        (entry,) = (e for e in archive.infolist() if e.filename.endswith("/data.pkl"))
    start = entry.header_offset
    cuts = [whole[: rng.randrange(len(whole))] for _ in range(20)]
    changed = []
    for _ in range(80):
        data = bytearray(whole)
        for _ in range(rng.randrange(1, 4)):
            # Most damage is in the pickle and the directory, since tensors may hold anything.
            place_of = rng.choice([start + rng.randrange(entry.file_size + 60), len(data) - 1 - rng.randrange(600)])
            data[place_of] = rng.randrange(256)
        changed.append(bytes(data))
    outcomes = set()
    for data in [*cuts, *changed]:
        file.write_bytes(data)
        try:
            read()
            outcomes.add("read")
        except SceneFolderError:
            outcomes.add("refused")
    assert "refused" in outcomes
    # A pickle that is changed, with the sum of the entry set right.
    with zipfile.ZipFile(io.BytesIO(whole)) as archive:
        pickled = archive.read(entry)
    for _ in range(150):
        data = bytearray(pickled)
        for _ in range(rng.randrange(1, 4)):
            data[rng.randrange(len(data))] = rng.randrange(256)
        file.write_bytes(whole)
        repacked(file, {"data.pkl": bytes(data)})
        try:
            read()
        except SceneFolderError:
            continue
