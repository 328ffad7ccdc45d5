"""The scene folder: encode turns the output of decode into the same bytes, and any other folder is a clear error."""

import copy
import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from plyfile import PlyData, PlyElement
from random_scenes import random_scene
from safetensors.numpy import load_file, save_file

from conformance.cases.scenes import MAIN_DIMENSIONS, with_steps
from conformance.cases.target import Target
from refcodec.bitstream import codec
from refcodec.bitstream.dimensions import Dimensions
from refcodec.bitstream.errors import BitstreamError
from refcodec.bitstream.header import RenderInfo
from refcodec.bitstream.reconstruction import reconstruct
from refcodec.bitstream.scene import Ancillary, take_anchors
from refcodec.encoder.positions import pack_positions
from refcodec.encoder.weights import pack_weights
from refcodec.folder import ply
from refcodec.folder.layout import SceneFolderError
from refcodec.folder.read import read_folder
from refcodec.folder.write import write_folder

NO_CARM = Dimensions(1, (4,), 1, 1, 2, (3,), (2,), (), 2)
DEEP = Dimensions(3, (1, 2, 1), 2, 3, 5, (6, 7), (3,), (4, 5), 4)


def odd_floats(seed: int):
    """A scene whose floats are hard to write as text, and whose weights have every kind of zero."""
    scene = random_scene(seed, 20, base_step=(1 / 3, 2.0**-60, 2.0**60))
    tiny = float(np.float32(1e-45))
    networks = copy.deepcopy(scene.networks)
    networks["opacity"][0][0][0, :2] = [-0.0, 1e-45]
    render = RenderInfo(background=(1, 2, 255), near_plane=tiny, alpha_max=tiny, low_pass=-0.0)
    return with_steps(replace(scene, render=render, networks=networks))


SCENES = {
    "tiny": lambda: random_scene(0, 50),
    "chunks": lambda: random_scene(1, 100, chunk_size=7),
    "main": lambda: random_scene(2, 600, MAIN_DIMENSIONS, chunk_size=256),
    "empty": lambda: random_scene(3, 0),
    "one": lambda: random_scene(4, 1, NO_CARM),
    "deep": lambda: random_scene(5, 33, DEEP),
    "none kept": lambda: random_scene(6, 9, keep=0.0),
    "all kept": lambda: random_scene(7, 9, keep=1.0),
    "ancillary": lambda: replace(
        random_scene(8, 5),
        ancillary=(Ancillary(b"noTe", 0, b""), Ancillary(b"noTe", 255, b"\0\1"), Ancillary(b"prIv", 7, bytes(1000), 5)),
    ),
    "odd floats": lambda: odd_floats(9),
    "packed": lambda: pack_weights(pack_positions(random_scene(10, 20, chunk_size=8))),
}


@pytest.mark.parametrize(
    "change", [{"cell_shift": 41}, {"frequency": [[1024] * 16] * 18}, {"frequency": [[1024] * 16] * 17}]
)
def test_a_wrong_model_of_positions(change, tmp_path):
    write_folder(SCENES["packed"](), tmp_path / "scene")
    file = tmp_path / "scene" / "scene.json"
    document = json.loads(file.read_text())
    document["position_model"] |= change
    file.write_text(json.dumps(document))
    with pytest.raises(SceneFolderError, match="position_model"):
        read_folder(tmp_path / "scene")


@pytest.mark.parametrize("name", SCENES)
def test_same_bytes(name, tmp_path):
    data = codec.emit(SCENES[name]())
    write_folder(codec.parse(data).scene, tmp_path / "scene")
    assert codec.emit(read_folder(tmp_path / "scene")) == data
    # What is written is a function of the scene alone.
    write_folder(codec.parse(data).scene, tmp_path / "again")
    for file in (tmp_path / "scene").iterdir():
        assert file.read_bytes() == (tmp_path / "again" / file.name).read_bytes()


@pytest.fixture(scope="module")
def scene():
    return replace(random_scene(11, 30, chunk_size=12), ancillary=(Ancillary(b"noTe", 1, b"five"),))


@pytest.fixture(scope="module")
def written(scene, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("written") / "scene"
    write_folder(scene, path)
    return path


@pytest.fixture
def made(written, tmp_path) -> Path:
    return Path(shutil.copytree(written, tmp_path / "scene"))


def refused(path: Path, *words: str) -> SceneFolderError:
    with pytest.raises(SceneFolderError) as raised:
        read_folder(path)
    text = str(raised.value)
    assert all(word in text for word in words), text
    assert raised.value.advice
    return raised.value


# --- writing ----------------------------------------------------------------------------------------------------------


def test_ply_layout(scene, made):
    """Every byte, and the properties as another program reads them."""
    values, n, names = reconstruct(scene), scene.anchor_count, ply.ply_properties(2, 5)
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {n}", *(f"property float {p}" for p in names)]
    offsets, zeros, ones = values.offsets.transpose(0, 2, 1).reshape(n, 6), np.zeros((n, 3)), np.ones((n, 1))
    columns = [values.positions, zeros, offsets, scene.masks, values.features, zeros[:, :1], values.scalings]
    table = np.concatenate([*columns, ones, zeros], axis=1).astype("<f4")
    data = "\n".join([*head, "end_header", ""]).encode() + table.tobytes()
    assert (made / "point_cloud.ply").read_bytes() == data
    vertex = PlyData.read(str(made / "point_cloud.ply"))["vertex"]
    for axis in range(3):
        assert np.array_equal(vertex["xyz"[axis]], values.positions[:, axis])
        for k in range(2):
            assert np.array_equal(vertex[f"f_offset_{axis * 2 + k}"], values.offsets[:, k, axis])
    assert np.array_equal(vertex["f_mask_1"], scene.masks[:, 1])
    fixed = ("rot_0", "nx", "ny", "nz", "opacity", "rot_1", "rot_2", "rot_3")
    assert [vertex[name][0] for name in fixed] == [1, *[0] * 7]


def test_names_of_networks(scene, made):
    arrays = load_file(made / "networks.safetensors")
    assert arrays["hyper.0.weight"].tobytes() == scene.networks["hyper"][0][0].tobytes()
    assert set(arrays) == {
        f"{n}.{i}.{p}" for n, layers in scene.networks.items() for i in range(len(layers)) for p in ("weight", "bias")
    }


def test_overwrites_a_scene_folder_whole(made):
    (made / "notes.txt").write_text("mine")
    other = random_scene(12, 4)
    write_folder(other, made)
    assert codec.emit(read_folder(made)) == codec.emit(other)
    assert not (made / "ancillary_0_noTe.bin").exists()
    assert (made / "notes.txt").read_text() == "mine"


def test_writes_into_an_empty_folder(scene, tmp_path):
    write_folder(scene, tmp_path)
    assert codec.emit(read_folder(tmp_path)) == codec.emit(scene)


@pytest.mark.parametrize("name", ["point_cloud.ply", "thesis.txt"])
def test_leaves_other_folders_alone(scene, tmp_path, name):
    (tmp_path / name).write_text("precious")
    with pytest.raises(SceneFolderError, match="not a scene folder"):
        write_folder(scene, tmp_path)
    with pytest.raises(SceneFolderError, match="not a scene folder"):
        write_folder(scene, tmp_path / name)
    assert os.listdir(tmp_path) == [name]
    assert (tmp_path / name).read_text() == "precious"


# --- reading ----------------------------------------------------------------------------------------------------------


def test_missing_folder(tmp_path):
    refused(tmp_path / "nothing", "no such folder")
    refused(tmp_path, "scene.json", "missing")


NAMES = ["scene.json", "point_cloud.ply", "networks.safetensors", "planes.safetensors", "coded.safetensors"]
JUNK_FILES = [b"", b"\x80\x04K\x01.", b"\xff" * 300, b"ply\nformat ascii 1.0\nend_header\n", b"[]", b"[" * 100_000]


@pytest.mark.parametrize("name", [*NAMES[:-1], "ancillary_0_noTe.bin"])
def test_missing_file(made, name):
    (made / name).unlink()
    refused(made, name, "missing")


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("content", [*JUNK_FILES, "cut"])
def test_wrong_file(made, name, content):
    (made / name).write_bytes((made / name).read_bytes()[:-5] if content == "cut" else content)
    refused(made, name)


def leaves(value, path=()):
    yield path
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in items:
        yield from leaves(item, (*path, key))


JUNK = [None, True, "x", -1, 256, 0.5, 1e300, 1 << 70, -(1 << 63), [], {}, [0], [[]], {"a": 1}]


@pytest.mark.slow
def test_no_field_of_scene_json_is_trusted(made):
    """Each field replaced with junk, or left out: a clear error, or a scene that emit takes or refuses."""
    file = made / "scene.json"
    document = json.loads(file.read_text())
    accepted = 0
    for path in list(leaves(document))[1:]:
        if path[0] == "digest":
            continue
        for junk in [*JUNK, "leave out"]:
            changed = copy.deepcopy(document)
            changed.pop("digest")
            at = changed
            for key in path[:-1]:
                at = at[key]
            if junk == "leave out":
                del at[path[-1]]
            else:
                at[path[-1]] = junk
            file.write_text(json.dumps(changed))
            try:
                scene = read_folder(made)
            except SceneFolderError:
                continue
            try:
                codec.parse(codec.emit(scene))
                accepted += 1
            except ValueError:
                pass
    assert accepted >= 20  # chunk_size, background and the like have other allowed values


def test_an_ancillary_section_stays_inside_the_folder(made):
    text = (made / "scene.json").read_text()
    (made / "scene.json").write_text(text.replace("ancillary_0_noTe.bin", "../secret"))
    refused(made, "ancillary[0].file")


def change_array(file: Path, name: str, change) -> None:
    """change: of the array, or None, which leaves it out."""
    arrays = load_file(file)
    array = arrays.pop(name, None)
    save_file(arrays if change is None else {**arrays, name: change(array)}, file)


def put(index, value):
    def change(array):
        array[index] = value
        return array

    return change


@pytest.mark.parametrize(
    ("file", "name", "change", "words"),
    [
        ("coded", "features", lambda a: a[:, :-1].copy(), ("features", "must be")),
        ("coded", "features", lambda a: a.astype(np.int64), ("int64", "int32")),
        ("coded", "features", put((0, 0), 1 << 23), ("features", "outside")),
        ("coded", "features", put((0, 0), -(1 << 31)), ("features", "outside")),
        ("coded", "positions", put((0, 0), 0x7C00), ("position",)),
        ("coded", "positions", put((0, 0), 0x8000), ("-0",)),
        ("coded", "positions", lambda a: a[:-1].copy(), ("positions", "29")),
        ("coded", "masks", put((0, 0), 2), ("mask",)),
        ("coded", "steps", put((0, 0), 255), ("step",)),
        ("coded", "surplus", lambda a: np.zeros(1, np.int32), ("surplus", "not known")),
        ("coded", "steps", None, ("steps", "missing")),
        ("planes", "planes", put((0, 0, 0, 0), -32768), ("-32768",)),
        ("planes", "planes", lambda a: a[:4].copy(), ("planes",)),
        ("planes", "planes", put((0, 0, 0, 0), 99), ("digest.planes",)),
        ("networks", "hyper.0.bias", put(0, np.nan), ("hyper.0.bias", "NaN")),
        ("networks", "hyper.0.bias", put(0, 1.5), ("digest.weights",)),
        ("networks", "opacity.0.weight", lambda a: a.T.copy(), ("opacity.0.weight",)),
    ],
)
def test_wrong_arrays(made, file, name, change, words):
    change_array(made / f"{file}.safetensors", name, change)
    refused(made, *words)


def test_masked_offset_is_zero(made, scene):
    where = tuple(np.argwhere(~scene.masks)[0])
    change_array(made / "coded.safetensors", "offsets", put((*where, 0), 1))
    refused(made, "offset", "not 0")


def rewrite_ply(path: Path, change) -> None:
    table = np.array(PlyData.read(str(path), mmap=False)["vertex"].data)
    PlyData([PlyElement.describe(change(table), "vertex")]).write(str(path))


def without(prefix: str):
    def change(table):
        names = [n for n in table.dtype.names if not n.startswith(prefix)]
        out = np.empty(len(table), [(n, table.dtype[n]) for n in names])
        for name in names:
            out[name] = table[name]
        return out

    return change


def with_value(name, index, value):
    return lambda table: put(index, value)(table[name]) is None or table


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        *(
            (with_value(name, 7, 12.5), f"{name} of anchor 7 is 12.5")
            for name in ("x", "f_offset_3", "f_mask_0", "f_anchor_feat_2", "scale_4")
        ),
        (lambda t: t[:-1], "29 anchors"),
        (without("scale_"), "0 properties scale_*"),
    ],
)
def test_edited_ply_is_refused(made, change, problem):
    rewrite_ply(made / "point_cloud.ply", change)
    assert "delete coded.safetensors" in refused(made, problem).advice


def test_ply_with_other_types_and_properties_is_the_same(made, scene):
    """Saved again by another program: without normals, as text."""
    rewrite_ply(made / "point_cloud.ply", without("n"))
    data = PlyData.read(str(made / "point_cloud.ply"), mmap=False)
    data.text = True
    data.write(str(made / "point_cloud.ply"))
    assert codec.emit(read_folder(made)) == codec.emit(scene)


def test_ply_without_masks_counts_as_all_kept(tmp_path, made):
    scene = random_scene(7, 9, keep=1.0)
    write_folder(scene, tmp_path / "kept")
    rewrite_ply(tmp_path / "kept" / "point_cloud.ply", without("f_mask_"))
    assert codec.emit(read_folder(tmp_path / "kept")) == codec.emit(scene)
    rewrite_ply(made / "point_cloud.ply", without("f_mask_"))
    refused(made, "f_mask_")


def test_header_edits_are_encoded(made, scene):
    """A digest that is deleted is not compared."""
    document = json.loads((made / "scene.json").read_text())
    del document["digest"]
    document["render"]["background"] = [9, 8, 7]
    document["chunk_size"] = 5
    (made / "scene.json").write_text(json.dumps(document))
    wanted = replace(scene, render=replace(scene.render, background=(9, 8, 7)), chunk_size=5)
    assert codec.emit(read_folder(made)) == codec.emit(wanted)


@pytest.mark.requirement("E12.1-1", "E12.1-2", "E12.1-3")
def test_a_changed_folder_keeps_what_is_safe_to_copy(tmp_path):
    """An editor that changes only metadata keeps every section; one that changes the scene keeps safe ones."""
    safe = Ancillary(b"noTe", 0, b"safe", 2), Ancillary(b"prIv", 7, b"", 5)
    scene = replace(random_scene(11, 9), ancillary=(*safe, Ancillary(b"prIV", 0, b"unsafe", 5)))
    folder = tmp_path / "scene"
    write_folder(scene, folder)
    document = json.loads((folder / "scene.json").read_text())

    def kept(**changes):
        (folder / "scene.json").write_text(json.dumps({**document, **changes}))
        return codec.parse(codec.emit(read_folder(folder))).scene.ancillary

    assert kept() == scene.ancillary
    assert kept(chunk_size=document["chunk_size"] + 1) == safe
    (folder / "coded.safetensors").unlink()
    assert kept() == safe
    unknown = Target(codec.emit(scene)).with_values({"directory[0].type": b"NEWS"})
    with pytest.raises(BitstreamError, match=r"\[R6\.6-2\]"):
        codec.parse(unknown)


@pytest.mark.requirement("E15.2-2", "E15.3-1")
@pytest.mark.parametrize(("minor", "later"), [(0, b""), (3, b"12345678")])
def test_a_changed_folder_keeps_its_minor_version(tmp_path, minor, later):
    """A file of this version has the lowest minor version. One of a later version keeps it, with its unknown bytes."""
    folder = tmp_path / "scene"
    write_folder(replace(random_scene(11, 9), minor=minor, later=later), folder)
    document = json.loads((folder / "scene.json").read_text())
    (folder / "scene.json").write_text(json.dumps({**document, "chunk_size": document["chunk_size"] + 1}))
    parsed = codec.parse(codec.emit(read_folder(folder))).scene
    assert (parsed.minor, parsed.later) == (minor, later)


# --- quantising anew --------------------------------------------------------------------------------------------------


def by_position(scene):
    """Anchors in an order of their own."""
    order = np.lexsort(scene.positions.T)
    return take_anchors(scene, order)


def test_requantised_reconstruction_is_the_same_scene(made, scene):
    """Values on the lattice of their steps give the same symbols again; anchors are sorted, empty ones dropped."""
    (made / "coded.safetensors").unlink()
    coded, wanted = by_position(read_folder(made)), by_position(take_anchors(scene, scene.masks.any(axis=1)))
    for kind in ("features", "scalings", "offsets", "steps"):
        assert np.array_equal(getattr(coded.attributes, kind), getattr(wanted.attributes, kind)), kind
    assert coded.positions.tobytes() == wanted.positions.tobytes()
    assert np.array_equal(coded.masks, wanted.masks)
    kept = ("grid", "render", "lanes", "chunk_size", "base_step", "profile", "dimensions", "plane_shift", "ancillary")
    for name in kept:
        assert getattr(coded, name) == getattr(scene, name), name
    codec.parse(codec.emit(coded))


def test_edited_ply_is_quantised(made, scene):
    (made / "coded.safetensors").unlink()
    rewrite_ply(made / "point_cloud.ply", without("f_mask_"))
    coded = read_folder(made)
    assert coded.masks.all()
    assert coded.anchor_count == scene.anchor_count
    rewrite_ply(made / "point_cloud.ply", with_value("x", 0, 1e30))
    refused(made, "point_cloud.ply", "cannot be quantised")
    rewrite_ply(made / "point_cloud.ply", without("f_anchor_feat_4"))
    refused(made, "4 features")


def trained(path: Path, masks: np.ndarray | None, count: int = 4) -> dict[str, np.ndarray]:
    """A point cloud as HAC writes it, K = 2, F = 3, with properties that nobody asked for."""
    rng = np.random.default_rng(0)
    sizes = {"f_offset": 6, "f_anchor_feat": 3, "scale": 6, "rot": 4, "f_mask": 0 if masks is None else masks.shape[1]}
    names = [*"xyz", "nx", "ny", "nz", "opacity", *(f"{stem}_{i}" for stem, size in sizes.items() for i in range(size))]
    columns = {name: rng.normal(size=count).astype(np.float32) for name in names}
    for k in range(sizes["f_mask"]):
        columns[f"f_mask_{k}"] = np.asarray(masks)[:, k].astype(np.float32)
    table = np.empty(count, [(name, "<f4") for name in columns])
    for name, column in columns.items():
        table[name] = column
    PlyData([PlyElement.describe(table, "vertex")]).write(str(path))
    return columns


def test_read_cloud(tmp_path):
    file = tmp_path / "point_cloud.ply"
    columns = trained(file, None)
    cloud = ply.read_cloud(file)
    assert np.array_equal(cloud.positions[:, 2], columns["z"])
    assert np.array_equal(cloud.offsets[:, 1, 2], columns["f_offset_5"])
    assert np.array_equal(cloud.offsets[:, 0, 1], columns["f_offset_2"])
    assert np.array_equal(cloud.features[:, 2], columns["f_anchor_feat_2"])
    assert np.array_equal(cloud.scalings[:, 5], columns["scale_5"])
    assert cloud.masks.shape == (4, 2)
    assert cloud.masks.all()


@pytest.mark.parametrize(
    ("values", "wanted"),
    [
        ([[0, 1], [1, 1], [0, 0], [1, 0]], [[0, 1], [1, 1], [0, 0], [1, 0]]),
        ([[0, 1], [1, 1], [-4.5, 0], [-4.7, 0]], [[1, 1], [1, 1], [1, 1], [0, 1]]),
    ],
    ids=["masks", "logits"],
)
def test_read_cloud_masks(tmp_path, values, wanted):
    trained(tmp_path / "p.ply", np.array(values))
    assert ply.read_cloud(tmp_path / "p.ply").masks.astype(int).tolist() == wanted


def test_read_cloud_of_a_scene_folder(made, scene):
    cloud = ply.read_cloud(made / "point_cloud.ply")
    assert np.array_equal(cloud.masks, scene.masks)
    assert np.array_equal(cloud.offsets, reconstruct(scene).offsets)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (without("scale_5"), "5 properties scale_"),
        (without("f_offset"), "f_offset"),
        (without("f_offset_2"), "numbered"),
        (without("z"), "xyz"),
        (without("f_anchor"), "feat"),
        (with_value("scale_0", 0, np.nan), "NaN"),
    ],
)
def test_read_cloud_refuses(tmp_path, change, words):
    file = tmp_path / "p.ply"
    trained(file, None)
    rewrite_ply(file, change)
    with pytest.raises(SceneFolderError, match=words):
        ply.read_cloud(file)


def test_read_cloud_refuses_more(tmp_path):
    file = tmp_path / "p.ply"
    with pytest.raises(SceneFolderError, match="no such file"):
        ply.read_cloud(file)
    trained(file, np.ones((4, 3)))
    with pytest.raises(SceneFolderError, match="f_mask_"):
        ply.read_cloud(file)
    lines = ["property list uchar float x", "property float y", "property float z", "end_header", "1 2 3 4", ""]
    file.write_text("\n".join(["ply", "format ascii 1.0", "element vertex 1", *lines]))
    with pytest.raises(SceneFolderError, match="a property of lists"):
        ply.read_cloud(file)
