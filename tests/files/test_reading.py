"""Untrusted files that the commands read: each is used as documented, or refused in one line with status 64."""

import io
import json
import os
import shutil
import struct
import warnings
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from random_scenes import random_scene
from safetensors.numpy import load_file, save

from refcodec.bitstream.cameras import NamedCamera
from refcodec.bitstream.reconstruction import reconstruct
from refcodec.cli.main import main
from refcodec.files.documents import DocumentError, parse_toml
from refcodec.files.ply import PlyError, check_ply_header
from refcodec.folder.layout import SceneFolderError
from refcodec.folder.ply import ply_properties, read_cloud
from refcodec.folder.uncompressed import Uncompressed, read_uncompressed, write_uncompressed
from refcodec.rendering.camera import read_camera

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "vectors" / "tiny-example.c3gs"
Captured = pytest.CaptureFixture[str]


def refused(capsys: Captured, *words: str | Path) -> str:
    """What a command says that refuses its input."""
    assert main([str(word) for word in words]) == 64
    message = capsys.readouterr().err
    assert len(message.splitlines()) == 1, message
    return message


# --- documents --------------------------------------------------------------------------------------------------------

CAMERA: dict[str, Any] = {
    "width": 40,
    "height": 30,
    "focal": [50, 50.5],
    "principal_point": [20, 15],
    "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "translation": [0, 0, 2],
}
WRONG_CAMERAS: list[tuple[str, Any]] = [
    *((name, None) for name in CAMERA),
    *(("width", wrong) for wrong in (0, 65536, 40.0, True, "40")),
    *(("height", wrong) for wrong in (-1, 10**400)),
    *(("focal", wrong) for wrong in ([0, 1], [1], [float("inf"), 1])),
    *(("principal_point", wrong) for wrong in ([float("nan"), 1], 7)),
    *(("rotation", [[1, 0, 0], [0, 1, 0], *last]) for last in ([], [[0, 0, -1]], [[0, 0, 1.01]])),
    *(("rotation", wrong) for wrong in ([[1e200, -1e200, 1e200]] * 3, [[True, 0, 0], [0, 1, 0], [0, 0, 1]])),
    *(("translation", wrong) for wrong in ([0, 0, "2"], [0, 0, 1e400])),
]


@pytest.mark.parametrize(
    "text", ["", "[]", "null", "[" * 100_000, *(json.dumps({**CAMERA, name: wrong}) for name, wrong in WRONG_CAMERAS)]
)
def test_cameras(text: str, tmp_path: Path, capsys: Captured) -> None:
    camera = read_camera(json.dumps(CAMERA))
    assert (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy) == (40, 30, 50, 50.5, 20, 15)
    assert camera.centre.tolist() == [0, 0, -2]
    (tmp_path / "camera.json").write_text(text)
    assert "is not a camera" in refused(capsys, "gaussians", EXAMPLE, tmp_path / "camera.json", tmp_path / "out.json")
    assert not (tmp_path / "out.json").exists()


@pytest.mark.parametrize(
    "text",
    [
        b"x = " + b"[" * 10_000,
        b"growth = " + b"[" * 60 + b"1" + b"]" * 60,
        b"growth." + b"a." * 500 + b"a = 1",
        b"steps = " + b"9" * 5000,
        b"steps = " + b"9" * 400,
        b"steps = inf",
        b"steps = 1979-05-27",
        b"seed = '\\u001b'",
        b"phases = 3",
        b"phases = [1]",
        b"phases = [{name = 'a', begin = 1, modes = {}, more = 2}]",
        b"[growth]\nedges = []",
        b"[[growth]]",
        b"a = '" + b"x" * (1 << 20) + b"'",
        b"steps = '''" + b"x" * 5000 + b"\n\n'''",
    ],
)
def test_settings(text: bytes, tmp_path: Path, capsys: Captured) -> None:
    (tmp_path / "settings.toml").write_bytes(text)
    assert len(refused(capsys, "train", "--settings", tmp_path / "settings.toml", "--print-settings")) <= 10_100


def test_changes_of_settings(capsys: Captured) -> None:
    for change in ("steps=" + "9" * 400, "steps=" + "[" * 10_000, "growth=" + "[" * 50 + "]" * 50):
        refused(capsys, "train", "--set", change, "--print-settings")
    assert parse_toml("a = [[1, 2], [3]]\n[b]\nc.d = 'x'") == {"a": [[1, 2], [3]], "b": {"c": {"d": "x"}}}
    with pytest.raises(DocumentError, match="nested deeper"):
        parse_toml(".".join(["a"] * 70) + " = 1")


# --- uncompressed scenes ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An uncompressed scene of some anchors."""
    scene, folder = random_scene(1, 4, keep=1), tmp_path_factory.mktemp("plain") / "scene"
    stated = (NamedCamera(), NamedCamera("1", translation=(1.0, 0.0, 0.0)))
    write_uncompressed(Uncompressed(reconstruct(scene), scene.masks, scene.networks, scene.render, stated), folder)
    return folder


@pytest.fixture
def folder(plain: Path, tmp_path: Path) -> Path:
    """A copy of the scene."""
    return Path(shutil.copytree(plain, tmp_path / "scene"))


def test_an_uncompressed_scene_is_read(folder: Path) -> None:
    """Also an earlier folder, which has one camera."""
    scene, document = read_uncompressed(folder), json.loads((folder / "render.json").read_text())
    assert scene.anchor_count == 4
    assert scene.networks["colour"][1][0].shape == (6, 3)
    assert [camera.name for camera in scene.cameras] == ["default", "1"]
    document["camera"] = document.pop("cameras")[1]
    (folder / "render.json").write_text(json.dumps(document))
    assert read_uncompressed(folder).cameras == scene.cameras[1:]


@pytest.mark.parametrize(
    ("member", "wrong", "field"),
    [
        *(("background", wrong, "render.background") for wrong in ([0, 0], [0, 0, 256], [0, 0, 0.5])),
        *(("up_axis", wrong, "render.up_axis") for wrong in (6, None)),
        *(("near_plane", wrong, "render.near_plane") for wrong in (0, "0.2")),
        ("distance_unit", -1, "render.distance_unit"),
        ("alpha_max", 1.5, "render.alpha_max"),
        ("low_pass", 1e300, "render.low_pass"),
        ("width", 1 << 32, "cameras[1].width"),
        ("height", 0, "cameras[1].height"),
        ("name", 7, "cameras[1].name"),
        ("name", "default", "cameras"),
        ("focal", 5, "cameras[1].focal"),
        *(("translation", wrong, "cameras[1].translation") for wrong in ([[0], [0], [0]], None)),
        ("focal", [0, 1], "cameras[1]"),
        ("rotation", [0, 0, 0, 0], "cameras[1]"),
    ],
)
def test_render_json_is_checked(member: str, wrong: Any, field: str, folder: Path, capsys: Captured) -> None:
    pytest.importorskip("numba")
    document = json.loads((folder / "render.json").read_text())
    (document["render"] if field.startswith("render") else document["cameras"][1])[member] = wrong
    (folder / "render.json").write_text(json.dumps(document))
    message = refused(capsys, "render", folder, "-o", folder.parent / "images")
    assert f'"{field}' in message
    assert "train it again" in message


@pytest.mark.parametrize("text", ["", "[]", "{}", "[" * 100_000, '{"format": "Scaffold-GS, uncompressed"}', "\xff"])
def test_other_files_are_not_render_json(text: str, folder: Path) -> None:
    (folder / "render.json").write_text(text, encoding="latin-1")
    with pytest.raises(SceneFolderError):
        read_uncompressed(folder)


@pytest.mark.parametrize(
    "change",
    [
        lambda a: a.pop("opacity.0.bias"),
        lambda a: a.update({"opacity.0.bias": a["opacity.0.bias"][:2]}),
        lambda a: a.update({"opacity.0.bias": np.zeros((), np.float32)}),
        lambda a: a.update({"colour.1.weight": a["colour.1.weight"].astype(np.float64)}),
        lambda a: a.update({"colour.1.weight": a["colour.1.weight"] * np.inf}),
        lambda a: a.update({"covariance.0.weight": a["covariance.0.weight"].T.copy()}),
    ],
)
def test_networks_are_checked(change: Callable[[dict[str, np.ndarray]], None], folder: Path) -> None:
    file = folder / "networks.safetensors"
    arrays = load_file(file)
    change(arrays)
    file.write_bytes(save(arrays))
    with pytest.raises(SceneFolderError, match="train it again"):
        read_uncompressed(folder)
    file.write_bytes((50 << 20).to_bytes(8, "little") + b"{" + b" " * 100)
    with pytest.raises(SceneFolderError, match="its header has 52428800 bytes"):
        read_uncompressed(folder)


# --- PLY --------------------------------------------------------------------------------------------------------------


def header(*lines: str) -> bytes:
    return "\n".join(["ply", "format binary_little_endian 1.0", *lines, "end_header", ""]).encode()


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "no end"),
        (b"png\n", "not begin"),
        (b"ply\n" + b"comment a\n" * 70_000, "longer"),
        (b"ply\ncomment " + b"a" * 10_000_000 + b"\n", "longer"),
        (header("element vertex 1", "property float f_offset_" + "9" * 5000), "longer"),
        (header("element vertex 1", "property float f_offset_" + "9" * 100), "64 characters"),
        (header("element vertex 1", *(f"property uchar p{i}" for i in range(2100))), "2100 properties"),
        (header(*(f"element e{i} 0" for i in range(20))), "20 elements"),
        (header("element vertex " + "9" * 400, "property float x"), "count"),
        (header("element vertex 4294967296", "property float x"), "count"),
        (header("element vertex 1000000000", "property float x") + b"abcd", "fewer bytes"),
        (
            header("element vertex 1", "property float x", "element face 4", "property list uchar int x"),
            "lists in its element face, as meshes",
        ),
        (header("element vertex"), "count"),
        (header("element vert\xe4x 1"), "not ASCII"),
    ],
)
def test_headers_of_ply_are_bounded(data: bytes, message: str, tmp_path: Path) -> None:
    file = tmp_path / "point_cloud.ply"
    file.write_bytes(data)
    for read, error in ((check_ply_header, PlyError), (read_cloud, SceneFolderError)):
        with pytest.raises(error, match=message):
            read(file)


def test_every_point_cloud_of_ours_is_within_the_bounds(plain: Path, tmp_path: Path) -> None:
    check_ply_header(plain / "point_cloud.ply")
    # The widest anchors of any profile: ten offsets, and eight slices of 255 channels would still be few.
    names = ply_properties(10, 1900)
    lines = [f"property float {name}" for name in names]
    (tmp_path / "wide.ply").write_bytes(header("element vertex 1", *lines) + bytes(4 * len(names)))
    check_ply_header(tmp_path / "wide.ply")


@settings(max_examples=100, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.data())
def test_a_changed_point_cloud_is_read_or_refused(plain: Path, tmp_path_factory: Any, data: st.DataObject) -> None:
    whole = (plain / "point_cloud.ply").read_bytes()
    at = data.draw(st.integers(0, 900))
    changed = whole[:at] + data.draw(st.binary(max_size=6)) + whole[at + data.draw(st.integers(0, 6)) :]
    file = tmp_path_factory.mktemp("cloud") / "point_cloud.ply"
    file.write_bytes(changed)
    try:
        cloud = read_cloud(file)
    except SceneFolderError:
        return
    assert len(cloud.positions) == len(cloud.masks)


# --- archives and images ----------------------------------------------------------------------------------------------


def archives() -> dict[str, bytes]:
    """Archives of points that are cut, encrypted, or damaged, have an array alone, or a pickle."""
    whole, array, pickled = io.BytesIO(), io.BytesIO(), io.BytesIO()
    np.savez_compressed(whole, means3d=np.zeros((5, 3)), colors=np.zeros((5, 3)))
    np.save(array, np.zeros(3))
    np.savez(pickled, means3d=np.array([{}], object), colors=np.zeros((1, 3)))
    data = whole.getvalue()
    encrypted = bytearray(data)
    with zipfile.ZipFile(whole) as archive:
        encrypted[6] |= 1
        encrypted[archive.start_dir + 8] |= 1
    damaged = data[:60] + bytes(30) + data[90:]
    return {
        "cut": data[:100], "encrypted": bytes(encrypted), "damaged": damaged, "array": array.getvalue(),
        "pickle": pickled.getvalue(), "junk": b"junk", "empty": b"", "head": b"PK\3\4cut",
    }  # fmt: skip


TEXTS = {"words.txt": b"not points\n", "remark.txt": b"# none\n", "junk.ply": b"junk"}


@pytest.mark.parametrize(("name", "data"), {**{f"{k}.npz": v for k, v in archives().items()}, **TEXTS}.items())
@pytest.mark.filterwarnings("ignore:.*no data")
def test_files_of_points(name: str, data: bytes, tmp_path: Path, capsys: Captured) -> None:
    pytest.importorskip("torch")
    (tmp_path / name).write_bytes(data)
    assert '"code"' not in refused(capsys, "fit", tmp_path / name, "-o", tmp_path / "scene", "--steps", "1")
    assert os.listdir(tmp_path) == [name]


def png(width: int, height: int, rows: int) -> bytes:
    """A grey image that has only some of its rows, with right checksums."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return len(data).to_bytes(4, "big") + kind + data + zlib.crc32(kind + data).to_bytes(4, "big")

    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    data = zlib.compress(bytes([0] + [99] * width) * rows)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def test_large_images_are_refused_by_their_header(tmp_path: Path) -> None:
    images = pytest.importorskip("refcodec.photographs.images")
    cameras = pytest.importorskip("refcodec.photographs.cameras")
    file = tmp_path / "a.png"
    # Below the bound, above the size of which Pillow warns.
    file.write_bytes(png(9999, 9999, 1))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert images.image_size(file) == (9999, 9999)
        for size in ((13_000, 13_000), (100_001, 1000), (60_000, 60_000)):
            file.write_bytes(png(*size, 1))
            for read in (images.image_size, lambda path: images.read_image(path, (0, 0, 0))):
                with pytest.raises(cameras.PhotographError) as caught:
                    read(file)
                assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize("suffix", ["png", "jpg", "bmp", "tiff", "webp"])
def test_cut_images_are_refused(suffix: str, tmp_path: Path) -> None:
    images = pytest.importorskip("refcodec.photographs.images")
    cameras = pytest.importorskip("refcodec.photographs.cameras")
    pixels = np.random.default_rng(0).integers(0, 256, (60, 80, 3)).astype(np.uint8)
    file = tmp_path / f"a.{suffix}"
    images.Image.fromarray(pixels).save(file)
    assert images.read_image(file, (0, 0, 0)).shape == (60, 80, 3)
    whole = file.read_bytes()
    if suffix == "png":
        for mode in ("1", "L", "LA", "P", "RGB", "RGBA"):
            for width, height in ((1, 1), (3, 2), (9, 17), (130, 70)):
                images.Image.new(mode, (width, height), 1 if mode in ("1", "L", "P") else None).save(file)
                assert images.read_image(file, (0, 0, 0)).shape == (height, width, 3)
    for cut in (whole[: len(whole) // 2], whole[:-1]):
        file.write_bytes(cut)
        with pytest.raises(cameras.PhotographError, match="export or copy the image again"):
            images.read_image(file, (0, 0, 0))
