"""The public interface: its names, its imports, and its use with files, scenes and notebooks."""

import ast
import io
import subprocess
import sys
from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import refcodec
from refcodec import api
from refcodec.bitstream.cameras import CAMERAS
from refcodec.bitstream.codec import parse
from refcodec.bitstream.directory import DATA
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.metadata import with_metadata
from refcodec.bitstream.reconstruction import digest, reconstruct
from refcodec.bitstream.scene import Ancillary, take_anchors
from refcodec.bitstream.scene import Scene as CodedScene
from refcodec.folder.layout import SceneFolderError
from refcodec.native.library import paths
from refcodec.pages import notebook
from refcodec.statuses import UsageError

ROOT = Path(__file__).resolve().parents[2]
TRAINED = ROOT / "vectors" / "valid" / "trained-caliterra.c3gs"
TINY = ROOT / "vectors" / "tiny-example.c3gs"


@pytest.fixture(scope="module")
def scene() -> refcodec.Scene:
    return refcodec.decode(TRAINED)


def _variants(value: Any) -> list[Any]:
    """A value or a dataclass with each field in turn, nested ones too, replaced by what does not belong there."""
    strange = [None, -1, 9, 1 << 16, 1 << 40, 1 << 70, 1.5, float("nan"), 1e300, "x", b"x", (), [0], {}, np.zeros(3)]
    variants = list(strange)
    if is_dataclass(value) and not isinstance(value, type):
        variants += [
            replace(value, **{field.name: other})
            for field in fields(value)
            for other in _variants(getattr(value, field.name))
        ]
    return variants


@pytest.mark.parametrize("name", ["valid/main-packed.c3gs", "valid/worked-example.c3gs"])
def test_encode_says_what_is_wrong_with_a_field(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever a field holds, the outcome is a file, or one ValueError or TypeError, the same with and without C."""
    coded = refcodec.decode(ROOT / "vectors" / name).coded
    coded = replace(coded, ancillary=(Ancillary(b"aBcd", 0, b"x"),))
    scenes = [scene for scene in _variants(coded) if isinstance(scene, CodedScene)]
    scenes += [replace(coded, ancillary=(section,)) for section in _variants(coded.ancillary[0])]
    scenes += [replace(coded, position_forms=(form,) * len(coded.chunks)) for form in (-1, 0, 9)]
    outcomes = []
    for path in paths()[:2]:
        monkeypatch.setenv("REFCODEC_PATH", path)
        texts = []
        for scene in scenes:
            try:
                texts.append(refcodec.encode(refcodec.Scene(scene)).hex())
            except (ValueError, TypeError) as error:
                texts.append(f"{type(error).__name__}: {error}")
        outcomes.append(texts)
    assert all(texts == outcomes[0] for texts in outcomes)
    assert len(set(outcomes[0])) > 100


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"profile": 2}, ValueError, r"found 2, allowed 0 \(Tiny\) or 1 \(Main\)"),
        ({"lanes": Lanes(9, 0, 0)}, ValueError, "found 9, allowed 0 to 8"),
        ({"plane_shift": 256}, ValueError, "plane_shift is no u8 from 0 to 255"),
        ({"chunk_size": 1 << 32}, ValueError, "header.chunk_size is no u32"),
        ({"base_step": (1.0, 1.0)}, ValueError, "scene.base_step must have 3 values, but has 2"),
        ({"lanes": Lanes(0, 0, "8")}, TypeError, "scene.lanes.attribute is '8', but must be int"),  # type: ignore[arg-type]
        ({"positions": [[0, 0, 0]]}, TypeError, "scene.positions is .*, but must be ndarray"),
    ],
    ids=str,
)
def test_encode_names_the_field_and_its_limits(
    change: dict[str, Any], error: type[Exception], message: str, scene: refcodec.Scene
) -> None:
    with pytest.raises(error, match=message):
        refcodec.encode(refcodec.Scene(replace(scene.coded, **change)))
    with pytest.raises(TypeError, match=r"encode takes a refcodec\.Scene"):
        refcodec.encode(scene.coded)  # type: ignore[arg-type]


def _arrays(value: Any) -> list[np.ndarray]:
    """All arrays in a value, which may be a dataclass, a dictionary, a list or a tuple."""
    if is_dataclass(value):
        value = list(vars(value).values())
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list | tuple):
        return [array for item in value for array in _arrays(item)]
    return [value] if isinstance(value, np.ndarray) else []


def test_arrays_of_a_scene_are_read_only(scene: refcodec.Scene) -> None:
    """A change of one was seen by gaussians, but neither by digest nor by encode."""
    arrays = [*_arrays(scene.coded), *_arrays(scene.values)]
    arrays += [scene.positions, scene.features, scene.scalings, scene.offsets, scene.masks]
    assert len(arrays) > 30
    assert not any(array.flags.writeable for array in arrays)
    # The caller's own arrays stay as they were.
    own = replace(scene.coded, positions=scene.coded.positions.copy())
    assert not refcodec.Scene(own).coded.positions.flags.writeable
    assert own.positions.flags.writeable
    assert refcodec.Scene(own).digest() == scene.digest()


DECODING = f"""
scene = refcodec.decode({str(TRAINED)!r})
refcodec.encode(scene), scene.positions, scene.sizes, scene.camera
refcodec.splats({str(TRAINED.with_name("static-degree-2.c3gs"))!r})
"""


@pytest.mark.parametrize(
    ("use", "absent"),
    [
        ("dir(refcodec)", "numpy torch numba refcodec.api"),
        (DECODING, "torch numba PIL scipy safetensors fsspec jinja2"),
    ],
    ids=["import", "decoding"],
)
def test_no_heavy_package_is_loaded(use: str, absent: str) -> None:
    program = f"import sys, refcodec\n{use}\nprint(sorted(set({absent!r}.split()) & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_type_checkers_read_the_same_names() -> None:
    """The stub and the list in the module have one set of names, which are names of the front door."""
    stub = ast.parse((ROOT / "refcodec" / "__init__.pyi").read_text(encoding="utf-8"))
    stated = {alias.asname for node in stub.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert stated == set(refcodec.__all__) - {"__version__"}
    assert stated - {"api"} <= set(api.__all__) <= set(dir(api))
    assert set(refcodec.__all__) <= set(dir(refcodec))
    with pytest.raises(AttributeError, match="no attribute 'encoder_of_dreams'"):
        refcodec.encoder_of_dreams  # type: ignore[attr-defined] # noqa: B018


def test_every_name_says_what_it_is() -> None:
    """Public classes, their members and functions have docstrings."""
    for name in api.__all__:
        thing = getattr(api, name)
        members = {
            k: v for k, v in vars(thing).items() if not k.startswith("_") and (callable(v) or hasattr(v, "fget"))
        }
        assert thing.__doc__, name
        for member, value in (members if isinstance(thing, type) else {}).items():
            assert value.__doc__, f"{name}.{member}"


def test_a_file_comes_back_as_it_was(scene: refcodec.Scene) -> None:
    data = TRAINED.read_bytes()
    for place in (TRAINED, str(TRAINED), data, bytearray(data), memoryview(data)):
        decoded = refcodec.decode(place)
        assert refcodec.encode(decoded) == data
        assert decoded.digest() == digest(parse(data).scene)[0]
    assert sum(scene.sizes.values()) == len(data)
    # A scene without a file is encoded for its sizes.
    assert refcodec.Scene(scene.coded).sizes == scene.sizes


class _Stream(io.RawIOBase):
    """A file object that cannot be moved in, and that returns at most seven bytes at once, as a socket may."""

    def __init__(self, data: bytes) -> None:
        self._file = io.BytesIO(data)

    def readable(self) -> bool:
        return True

    def read(self, size: int = -1) -> bytes:
        return self._file.read(min(size, 7))


class _Short(io.BytesIO):
    """A file object that can be moved in, and that returns at most seven bytes at once, as a raw file may."""

    def read(self, size: int | None = -1) -> bytes:
        return super().read(min(size or 0, 7))


def test_file_objects(tmp_path: Path) -> None:
    """Seekable ones are read on request, from their start, and others once. All stay open."""
    data = TINY.read_bytes()
    with open(TINY, "rb") as stored, open(TINY, "rb", buffering=0) as raw:
        stored.seek(5)
        for file in (stored, raw, io.BytesIO(data), _Short(data), _Stream(data)):
            with refcodec.open(file) as opened:
                assert opened.byte_count == len(data)
                assert refcodec.encode(opened.decode()) == data
            assert not file.closed
    # What is behind the file is not read.
    endless = _Stream(data + bytes(1 << 16))
    with pytest.raises(refcodec.BitstreamError) as caught:
        refcodec.decode(endless)
    assert caught.value.kind.code == 321
    assert endless._file.tell() == len(data) + 1
    with pytest.raises(refcodec.BoundPassedError):
        refcodec.decode(_Stream(data), limits=refcodec.Limits(memory=1000))
    for wrong in (io.StringIO("text"), None, 7):
        with pytest.raises(TypeError, match="in binary mode is required"):
            refcodec.open(wrong)  # type: ignore[arg-type]


def test_save(tmp_path: Path) -> None:
    """To a path, which is replaced, and to a file object."""
    scene, path, held = refcodec.decode(TINY), tmp_path / "scene.c3gs", io.BytesIO()
    path.write_bytes(b"older")
    scene.save(path)
    scene.save(str(tmp_path / "again.c3gs"))
    scene.save(held)
    assert path.read_bytes() == (tmp_path / "again.c3gs").read_bytes() == held.getvalue() == TINY.read_bytes()
    assert sorted(file.name for file in tmp_path.iterdir()) == ["again.c3gs", "scene.c3gs"]


def test_export_of_another_scene(scene: refcodec.Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One fit makes all outputs. tests/cli/test_export.py has its files, and those of a static scene."""
    pytest.importorskip("numba")
    from refcodec.export import fit, views  # noqa: PLC0415

    fits, whole = [], fit.fit
    monkeypatch.setattr(fit, "fit", lambda *given: fits.append(given) or whole(*given))
    monkeypatch.setattr(views, "AROUND", 18)
    monkeypatch.setattr(views, "SIDE", 32)
    outputs = [tmp_path / "a.ply", tmp_path / "a.glb"]
    splats = api.export(scene, outputs, degree=1, iterations=0).values["splats"]
    assert (len(fits), [path.exists() for path in outputs]) == (1, [True, True])
    assert (splats.degree, splats.mean.flags.writeable) == (1, False)
    # Without outputs it returns the Gaussians only.
    seen = api.export(scene, [], degree=0, iterations=0, cameras=[scene.camera]).values["splats"]
    assert 0 < len(seen.mean) <= scene.masks.sum()
    assert [camera.name for camera in fits[-1][1]] == [scene.camera.name]
    for wrong in ({"degree": 4}, {"iterations": -1}, {"cameras": []}, {"cameras": [None]}):
        with pytest.raises(ValueError, match=r"must be|is empty"):
            api.export(scene, [], **wrong)  # type: ignore[arg-type]


def test_a_camera_looks_at_a_point(scene: refcodec.Scene) -> None:
    """SPEC 14.2: the point is in the middle of the image, and what is above it is in the upper half."""
    camera = refcodec.Camera.look_at((3, -4, 2), (1, 1, 1), scene.up, 640, 480, fov=60)
    assert np.allclose(camera.centre, (3, -4, 2))
    assert np.allclose(camera.rotation @ camera.rotation.T, np.eye(3))
    assert np.linalg.det(camera.rotation) > 0

    def pixel(point: Any) -> tuple[float, float, float]:
        x, y, z = camera.rotation @ point + camera.translation
        return camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy, z

    middle = np.ones(3)
    assert np.allclose(pixel(middle)[:2], (320, 240))
    assert pixel(middle)[2] > 0
    assert pixel(middle + scene.up)[1] < 240
    # The upper edge is half of the angle above the middle.
    edge = np.tan(np.radians(30)) * np.linalg.norm(middle - camera.centre)
    assert np.allclose(pixel(middle - edge * camera.rotation[1])[1], 0)
    assert len(scene.gaussians(camera).mean)
    for change, message in (
        ({"target": (3, -4, 2)}, "the target is at the eye"),
        ({"up": (2, -5, 1)}, "up is parallel"),
        ({"up": (0, 0, 0)}, "up is parallel"),
        ({"eye": (0, 0)}, "eye is"),
        ({"eye": (0, 0, float("nan"))}, "eye is"),
        ({"fov": 180}, "below 180"),
        ({"width": 0}, "whole numbers above 0"),
        ({"width": 1.5}, "whole numbers above 0"),
    ):
        given = {"eye": (3, -4, 2), "target": (1, 1, 1), "up": (0, 0, 1), "width": 640, "height": 480, "fov": 60}
        with pytest.raises(ValueError, match=message):
            refcodec.Camera.look_at(**{**given, **change})  # type: ignore[arg-type]


def test_values_have_the_stated_shapes(scene: refcodec.Scene) -> None:
    n, k = scene.anchor_count, scene.offset_count
    values = reconstruct(scene.coded)
    shapes = {
        "positions": (n, 3),
        "features": (n, scene.coded.dimensions.features),
        "scalings": (n, 6),
        "offsets": (n, k, 3),
    }
    for name, shape in shapes.items():
        array = getattr(scene, name)
        assert (array.shape, array.dtype) == (shape, np.float32)
        assert np.array_equal(array, getattr(values, name))
    assert (scene.masks.shape, scene.masks.dtype) == ((n, k), np.bool_)
    drawn = scene.gaussians()
    assert drawn.mean.shape == (len(drawn.opacity), 3)
    assert scene.masks[drawn.anchor, drawn.offset].all()
    assert repr(scene) == f"<refcodec.Scene: {n:,} anchors, {scene.masks.sum():,} of {n * k:,} offsets kept>"


def test_plain_gaussians_of_a_static_scene(tmp_path: Path) -> None:
    """They are the same from a path, from bytes, from a scene and from its export, and cannot be changed."""
    static = TRAINED.with_name("static-degree-2.c3gs")
    scene = refcodec.decode(static)
    n = int(scene.masks.sum())
    shapes = {"mean": (n, 3), "base": (n, 3), "rest": (n, 8, 3), "opacity": (n,), "scale": (n, 3), "quaternion": (n, 4)}
    exported = api.export(scene, [tmp_path / f"a.{suffix}" for suffix in ("ply", "spz", "glb")]).values["splats"]
    for splats in (refcodec.splats(static), refcodec.splats(static.read_bytes()), scene.splats, exported):
        assert isinstance(splats, refcodec.Splats)
        assert splats.degree == 2
        assert list(vars(splats)) == list(shapes)
        for name, values in vars(splats).items():
            assert (values.shape, values.dtype, values.flags.writeable) == (shapes[name], np.float32, False)
            np.testing.assert_array_equal(values, getattr(scene.splats, name))
    # Those of a view are the same ones.
    assert np.array_equal(scene.gaussians().mean, scene.splats.mean)
    assert len(refcodec.splats(TRAINED.with_name("static-empty.c3gs")).mean) == 0


def test_other_scenes_have_no_plain_gaussians(scene: refcodec.Scene) -> None:
    """Nothing is decoded for the verdict, and bounds hold as for decode."""
    with pytest.raises(ValueError, match="`refcodec export FILE -o OUTPUT`"):
        refcodec.splats(TRAINED)
    with pytest.raises(ValueError, match="depend on the view"):
        refcodec.splats(TRAINED, limits=refcodec.Limits(anchors=1))
    with pytest.raises(ValueError, match="depend on the view"):
        _ = scene.splats
    with pytest.raises(refcodec.BoundPassedError):
        refcodec.splats(TRAINED.with_name("static-degree-2.c3gs"), limits=refcodec.Limits(anchors=1))
    with pytest.raises(refcodec.BitstreamError):
        refcodec.splats(TRAINED.with_name("static-degree-2.c3gs").read_bytes()[:-1])


def test_a_folder_comes_back_as_it_was(scene: refcodec.Scene, tmp_path: Path) -> None:
    scene.write(tmp_path / "scene")
    assert refcodec.encode(refcodec.Scene.read(tmp_path / "scene")) == TRAINED.read_bytes()
    with pytest.raises(SceneFolderError):
        refcodec.Scene.read(tmp_path)


class _Counting(io.FileIO):
    """A file on a disk that notes how many bytes are read of it."""

    read_bytes = 0

    def read(self, size: int | None = -1) -> bytes:
        block = super().read(size)
        self.read_bytes += len(block)
        return block


def test_an_open_file_reads_what_is_asked_for(monkeypatch: pytest.MonkeyPatch, scene: refcodec.Scene) -> None:
    """The header at once, a chunk with what comes before all chunks, and never the whole file."""
    opened = []

    def counting(path: Path, mode: str) -> _Counting:
        assert mode == "rb"
        opened.append(_Counting(path))
        return opened[-1]

    many = ROOT / "vectors" / "valid" / "chunks-uneven.c3gs"
    monkeypatch.setattr("refcodec.folder.places.builtins", SimpleNamespace(open=counting))
    with refcodec.open(many) as file:
        (counted,) = opened
        section = file.header.section(DATA)
        assert counted.read_bytes < section.start
        whole = refcodec.Scene(parse(many.read_bytes()).scene)
        number = file.chunk_count - 1
        (chunk,) = file.chunks(range(number, number + 1))
        assert counted.read_bytes < file.byte_count
        assert chunk.number == number
        assert np.array_equal(chunk.values.positions, whole.positions[chunk.first :])
        assert sum(chunk_of.scene.anchor_count for chunk_of in file) == file.anchor_count == whole.anchor_count
        assert refcodec.encode(file.decode()) == many.read_bytes()
        with pytest.raises(IndexError, match="there is no chunk"):
            list(file.chunks(range(file.chunk_count, file.chunk_count + 1)))
    assert counted.closed


def test_a_file_says_what_a_scene_says(scene: refcodec.Scene) -> None:
    """Without decoding."""
    with refcodec.open(TRAINED) as file:
        assert (file.anchor_count, file.offset_count) == (scene.anchor_count, scene.offset_count)
        assert file.sizes == scene.sizes
        assert file.metadata == scene.metadata
        assert [vars(c).keys() for c in file.cameras] == [vars(c).keys() for c in scene.cameras]
        assert [c.name for c in file.cameras] == [c.name for c in scene.cameras]
        assert repr(file).startswith(f"<refcodec.File: {TRAINED.stat().st_size:,} bytes")


def test_a_refused_file_says_why(tmp_path: Path) -> None:
    data = bytearray(TINY.read_bytes())
    data[0] ^= 1
    with pytest.raises(refcodec.BitstreamError) as caught:
        refcodec.open(data)
    assert caught.value.kind.code == 102
    damaged = tmp_path / "damaged.c3gs"
    damaged.write_bytes(TINY.read_bytes()[:-4])
    with refcodec.open(damaged) as file, pytest.raises(refcodec.BitstreamError):
        list(file)


def test_places_that_hold_no_file(tmp_path: Path) -> None:
    for place in (tmp_path, tmp_path / "none.c3gs"):
        with pytest.raises(OSError, match=str(tmp_path)):
            refcodec.open(place)
    with pytest.raises(UsageError):
        refcodec.open("nothing://there")


def test_a_scene_draws_itself(scene: refcodec.Scene) -> None:
    pytest.importorskip("numba")
    from refcodec.rendering.view import View, eight_bits, own_camera  # noqa: PLC0415

    made = scene.render()
    view = View(scene.coded)
    assert np.array_equal(made, eight_bits(view.draw(own_camera(view.camera))))
    assert (made.dtype, made.shape[2]) == (np.uint8, 3)
    small = scene.camera.resized(40, 30)
    assert scene.render(small).shape == (30, 40, 3)
    assert len(scene.orbit(3)) == 3


def test_a_missing_extra_is_named() -> None:
    program = f"""
import sys, refcodec
sys.modules["numba"] = None
try:
    refcodec.decode({str(TRAINED)!r}).render()
except ModuleNotFoundError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "drawing needs numba: pip install 'refcodec[render]'\n"


def _no_render(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "refcodec.rendering.view", None)


def _too_large(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("refcodec.api.scenes.DRAWN_ANCHORS", 10)


@pytest.mark.parametrize(("without", "shown"), [(None, "<img"), (_no_render, "<svg"), (_too_large, "<svg")])
def test_a_notebook_shows_a_scene(
    without: Callable[[pytest.MonkeyPatch], None] | None,
    shown: str,
    scene: refcodec.Scene,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its figures, its bytes by part, and an image of it, or else some of its points."""
    if without:
        without(monkeypatch)
    else:
        pytest.importorskip("numba")
    text = refcodec.Scene(scene.coded, scene.sizes)._repr_html_()
    assert f"{scene.anchor_count:,}" in text
    for name, size in scene.sizes.items():
        assert (f">{name}</th>" in text) == (size > 0)
    assert f"{TRAINED.stat().st_size:,} bytes" in text
    assert shown in text
    assert text.count("<circle") <= notebook.POINTS
    assert text.count("<circle") > 50 or shown == "<img"


def test_a_scene_without_anchors_shows_itself(scene: refcodec.Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    _no_render(monkeypatch)
    empty = refcodec.Scene(take_anchors(scene.coded, slice(0, 0)))
    assert "<svg" not in empty._repr_html_()
    assert "bytes" not in empty._repr_html_()


def test_a_notebook_runs_nothing_of_a_file(scene: refcodec.Scene) -> None:
    """Metadata is text of others."""
    hostile = "<script>alert(1)</script>\u202e" + "x" * 300
    coded = replace(scene.coded, ancillary=with_metadata(scene.coded.ancillary, {"title": hostile}))
    data = refcodec.encode(refcodec.Scene(coded))
    for text in (refcodec.decode(data)._repr_html_(), refcodec.open(data)._repr_html_()):
        assert "<script" not in text
        assert "&lt;script&gt;" in text
        assert "\u202e" not in text
        assert "x" * 200 not in text


def test_a_damaged_section_of_cameras_tells_nothing(scene: refcodec.Scene) -> None:
    """Decoding refuses the file. An open one has no cameras then."""
    data = bytearray(TRAINED.read_bytes())
    with refcodec.open(data) as file:
        section = next(s for s in file.header.sections if s.type == CAMERAS)
        assert file.cameras
    data[section.start] ^= 1
    with refcodec.open(data) as file:
        assert file.cameras == []
        with pytest.raises(refcodec.BitstreamError):
            file.decode()
