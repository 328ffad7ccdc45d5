"""Folders of posed photographs: written values are read back, no step changes geometry, and faults are clear errors."""

import contextlib
import inspect
import json
import re
import shutil
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("PIL", reason="the reader of photographs needs the packages of the extra train")
pytest.importorskip("scipy", reason="the reader of photographs needs the packages of the extra train")

from PIL import Image
from plyfile import PlyData, PlyElement
from scipy.spatial.transform import Rotation

from refcodec.bitstream.cameras import NamedCamera
from refcodec.folder.georeference import georeference, stated_offset
from refcodec.photographs import colmap, images, lens, transforms
from refcodec.photographs.as_trained import scene_offset
from refcodec.photographs.cameras import Camera, PhotographError, quaternion_rotation
from refcodec.photographs.photographs import parse_background, parse_size, read_photographs

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples" / "photographs"
WIDTH, HEIGHT, COUNT, POINTS = 40, 30, 10, 25
PINHOLE = ("PINHOLE", WIDTH, HEIGHT, (35.5, 36.25, 20.5, 14.75))
PARTS = ("cameras", "images", "points3D")
MODEL_IDS = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV")


# --- datasets ---------------------------------------------------------------------------------------------------------


NAN, INF = float("nan"), float("inf")


def model(count=COUNT, camera=PINHOLE, seed=0):
    """cameras {id: (model, width, height, parameters)}, images, points.

    An image is (id, quaternion, translation, camera, name, 2D points).
    """
    rng = np.random.default_rng(seed)
    quaternions, translations = rng.normal(size=(count, 4)), rng.normal(size=(count, 3))
    rows = [
        (i + 3, quaternions[i], translations[i], 7, f"{i:02}.png", [(1.5, 2.25, 4), (3.0, 4.0, -1)] if i % 2 else [])
        for i in range(count)
    ]
    points = [(i + 1, rng.normal(size=3), rng.integers(0, 256, 3), 0.5, [(3, 0), (5, 1)]) for i in range(POINTS)]
    return {7: camera}, rows, points


def write_text(folder, cameras, rows, points):
    folder.mkdir(parents=True, exist_ok=True)
    lenses = [(i, m, w, h, *map(float, p)) for i, (m, w, h, p) in cameras.items()]
    poses = [
        line
        for i, q, t, camera, name, seen in rows
        for line in ((i, *map(float, (*q, *t)), camera, name), [v for s in seen for v in s])
    ]
    cloud = [(i, *map(float, p), *map(int, c), e, *(v for t in track for v in t)) for i, p, c, e, track in points]
    for part, lines in zip(PARTS, (lenses, poses, cloud), strict=True):
        text = [f"# {part}", *(" ".join(map(str, line)) for line in lines)]
        (folder / f"{part}.txt").write_text("\n".join(text) + "\n")


def write_binary(folder, cameras, rows, points):
    folder.mkdir(parents=True, exist_ok=True)
    data = struct.pack("<Q", len(cameras))
    for i, (m, w, h, p) in cameras.items():
        data += struct.pack(f"<IiQQ{len(p)}d", i, MODEL_IDS.index(m), w, h, *p)
    (folder / "cameras.bin").write_bytes(data)
    data = struct.pack("<Q", len(rows))
    for i, q, t, camera, name, seen in rows:
        data += struct.pack("<I7dI", i, *q, *t, camera) + name.encode() + b"\0" + struct.pack("<Q", len(seen))
        data += b"".join(struct.pack("<ddq", *s) for s in seen)
    (folder / "images.bin").write_bytes(data)
    data = struct.pack("<Q", len(points))
    for i, p, c, e, track in points:
        data += struct.pack("<Q3d3BdQ", i, *p, *(int(v) for v in c), e, len(track)) + b"".join(
            struct.pack("<II", *t) for t in track
        )
    (folder / "points3D.bin").write_bytes(data)


WRITERS = {"text": write_text, "binary": write_binary}


def pixels(seed, width=WIDTH, height=HEIGHT):
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


def write_images(folder, names, width=WIDTH, height=HEIGHT):
    folder.mkdir(parents=True, exist_ok=True)
    for i, name in enumerate(names):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(pixels(i, width, height)).save(folder / name)


def write_colmap(folder, writer=write_text, place="sparse/0", content=None, **camera):
    content = content or model(**camera)
    writer(folder / place, *content)
    write_images(folder / "images", [row[4] for row in content[1]], *content[0][7][1:3])
    return content


@pytest.fixture(scope="module", params=WRITERS)
def template(request, tmp_path_factory):
    """A whole COLMAP folder, text and binary in turn."""
    folder = tmp_path_factory.mktemp("colmap") / request.param
    write_colmap(folder, WRITERS[request.param])
    return folder


@pytest.fixture
def made(template, tmp_path):
    return Path(shutil.copytree(template, tmp_path / template.name))


@pytest.fixture
def text(tmp_path):
    write_colmap(tmp_path / "text")
    return tmp_path / "text"


def edit(file: Path, old: str, new: str):
    content = file.read_text()
    assert old in content
    file.write_text(content.replace(old, new, 1))


def refused(folder, *words, **arguments):
    """The error of reading a folder and all its images, which says all the words."""
    with pytest.raises(PhotographError) as caught:
        [(photograph.image, photograph.mask) for photograph in read_photographs(folder, **arguments).train]
    message = str(caught.value)
    assert all(word in message for word in words), message
    assert caught.value.problem
    assert caught.value.advice
    return caught.value


def everything(photographs):
    return sorted((*photographs.train, *photographs.test), key=lambda p: p.camera.name)


def project(camera, points):
    """Positions [N, 2] in the image, by the definition."""
    p = points @ camera.rotation.T + camera.translation
    return np.stack([camera.fx * p[:, 0] / p[:, 2] + camera.cx, camera.fy * p[:, 1] / p[:, 2] + camera.cy], axis=1)


# --- COLMAP -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("place", ["sparse/0", "sparse", "."])
@pytest.mark.parametrize("writer", WRITERS)
def test_colmap_is_read_back(writer, place, tmp_path):
    _, rows, points = write_colmap(tmp_path, WRITERS[writer], place)
    (tmp_path / "images" / "notes.md").write_text("not an image")
    photographs = read_photographs(tmp_path)
    assert [p.camera.name for p in photographs.test] == ["00.png", "08.png"]
    assert [p.camera.name for p in photographs.train] == [f"{i:02}.png" for i in range(COUNT) if i % 8]
    assert photographs.skipped == 0
    for i, (photograph, (_, q, t, _, name, _)) in enumerate(zip(everything(photographs), rows, strict=True)):
        c = photograph.camera
        assert (c.name, c.width, c.height, c.fx, c.fy, c.cx, c.cy) == (name, *PINHOLE[1:3], *PINHOLE[3])
        np.testing.assert_allclose(c.rotation, Rotation.from_quat(q[[1, 2, 3, 0]]).as_matrix(), atol=1e-14)
        np.testing.assert_array_equal(c.translation, t)
        np.testing.assert_allclose(c.rotation @ c.centre + c.translation, 0, atol=1e-14)
        np.testing.assert_array_equal(photograph.image, pixels(i))
        assert photograph.image is photograph.image
        assert photograph.image.dtype == np.uint8
    np.testing.assert_array_equal(photographs.points, [p[1] for p in points])
    np.testing.assert_array_equal(photographs.colours, [p[2] for p in points])
    assert (photographs.points.dtype, photographs.colours.dtype, c.rotation.dtype) == (np.float64, np.uint8, np.float64)


@pytest.mark.parametrize("writer", WRITERS)
@pytest.mark.parametrize(
    ("name", "parameters", "expected"),
    [
        ("SIMPLE_PINHOLE", (35, 20, 15), (35, 35, 20, 15)),
        ("SIMPLE_RADIAL", (35, 20, 15, 0), (35, 35, 20, 15)),
        ("RADIAL", (35, 20, 15, 0, 0), (35, 35, 20, 15)),
        ("OPENCV", (35, 36, 20, 15, 0, 0, 0, 0), (35, 36, 20, 15)),
        ("FULL_OPENCV", (35, 36, 20, 15, 0, 0, 0, 0, 0, 0, 0, 0), (35, 36, 20, 15)),
    ],
)
def test_camera_models(writer, name, parameters, expected, tmp_path):
    write_colmap(tmp_path, WRITERS[writer], camera=(name, WIDTH, HEIGHT, parameters))
    c = read_photographs(tmp_path).train[0].camera
    assert (c.fx, c.fy, c.cx, c.cy) == expected


def test_names_in_folders_and_with_spaces(tmp_path):
    cameras, rows, points = model()
    rows = [(i, q, t, c, f"left {i % 2}/a photograph {name}", s) for i, q, t, c, name, s in reversed(rows)]
    write_colmap(tmp_path, content=(cameras, rows, points))
    names = [p.camera.name for p in everything(read_photographs(tmp_path))]
    assert names == sorted(row[4] for row in rows)


def renamed(old, new):
    """The names of the model are others than those of the files."""

    def rename(folder):
        cameras, rows, points = model()
        write_text(folder / "sparse/0", cameras, [(*row[:4], new(row[4]), row[5]) for row in rows], points)
        shutil.rmtree(folder / "images")
        write_images(folder / "images", [old(row[4]) for row in rows])

    return rename


def with_points(*places):
    """The model has more points."""

    def write(folder):
        cameras, rows, points = model()
        more = [(100 + i, np.array(place), np.zeros(3), 0.5, []) for i, place in enumerate(places)]
        write_text(folder / "sparse/0", cameras, rows, [*points, *more])

    return write


@pytest.mark.parametrize(
    ("made_so", "noted"),
    [
        (renamed(lambda name: f"Left/{name.upper()}", lambda name: f"left\\{name}"), []),
        (renamed(str.upper, str), []),
        (renamed(lambda name: f"Stra\u00dfe \u00e9 {name}", lambda name: f"STRASSE e\u0301 {name}"), []),
        (renamed(str, lambda name: name.removesuffix(".png")), []),
        (lambda folder: (folder / "masks").mkdir(), ["10 photographs of 10 without a mask (masks/01.png.png"]),
        (lambda folder: write_text(folder / "sparse/1", *model(3, seed=1)), ["1 with 3 images is not used"]),
        (
            lambda folder: [(folder / "sparse/0").rename(folder / "sparse/12"), write_colmap(folder, count=2, seed=1)],
            ["0 with 2 images is not used", "12 has 10"],
        ),
        (with_points((1e3, 0, 0)), ["1 point of 26 left out, up to 1e+03 units away"]),
        (with_points((0, NAN, 0)), ["1 point of 26 left out, NaN or infinite"]),
        (with_points((0, NAN, 0), (0, 9e7, 0)), ["2 points of 27 left out, NaN or infinite or up to 9e+07"]),
        (with_points((0, -1e6, 0), (0, 9e7, 0)), ["2 points of 27 left out, up to 9e+07"]),
        (with_points((0, 1e3, 0), (1, 1e3, 0), (2, 1e3, 0)), None),
    ],
)
def test_folders_of_other_programs(made_so, noted, tmp_path):
    """They are read as the plain folder is, and what was chosen or left out is said. A sky of many points stays."""
    write_colmap(tmp_path)
    plain = everything(read_photographs(tmp_path))
    seen = [p.image for p in plain]
    made_so(tmp_path)
    taken = read_photographs(tmp_path)
    for image, a, b in zip(seen, plain, everything(taken), strict=True):
        np.testing.assert_array_equal(image, b.image)
        np.testing.assert_array_equal(a.camera.translation, b.camera.translation)
    if noted is None:
        assert (len(taken.points), taken.notes) == (POINTS + 3, ())
    else:
        assert len(taken.points) == POINTS
        assert all(words in " ".join(taken.notes) for words in noted)
        assert bool(noted) == bool(taken.notes)


@pytest.mark.parametrize("name", ["{}.png", "{}.png.png"])
@pytest.mark.parametrize("camera", [PINHOLE, ("RADIAL", WIDTH, HEIGHT, (35, 20, 15, 0.05, 0.01))])
def test_a_mask_is_seen_as_its_photograph(camera, name, tmp_path):
    """Photographs that show their masks in white are white where they count. Only black, of any format, is excluded."""
    write_colmap(tmp_path, camera=camera)
    (tmp_path / "masks").mkdir()
    for i in range(1, COUNT):
        mask = np.kron(pixels(i, WIDTH // 5, HEIGHT // 5)[..., 0] % 2, np.ones((5, 5), np.uint8))
        Image.fromarray(255 * mask).save(tmp_path / f"images/{i:02}.png")
        Image.fromarray(mask).save(tmp_path / "masks" / name.format(f"{i:02}"))
    for size in (None, 30, 16):
        taken = read_photographs(tmp_path, size)
        assert taken.test[0].mask is None
        assert "1 photograph of 10 without a mask" in taken.notes[0]
        assert all(tmp_path / "masks" / name.format(p.path.stem) in taken.places() for p in taken.train)
        for photograph in taken.train:
            np.testing.assert_array_equal(photograph.mask, photograph.image[..., 0] == 255)


def test_notes_on_masks_and_small_images(nerf):
    write_images(nerf, ["r_1.png"], 20, 15)
    change(nerf, lambda d: [d["frames"][1].update(mask_path="r_1.png"), d.update(w=40, h=30)])
    Image.fromarray(pixels(2, 20, 15)).save(nerf / "images/r_2.png")
    assert [len(read_photographs(nerf, size).notes) for size in (None, 20, (20, 15))] == [2, 1, 1]
    masked, small = read_photographs(nerf).notes
    assert masked.startswith("9 photographs of 10 without a mask")
    assert read_photographs(nerf).train[0].mask.all()
    assert small.startswith("1 image of 10 smaller than the others")
    assert "r_2.png" in small


def test_coordinates_of_a_map(tmp_path):
    """An offset brings the cameras and points to the origin, and the numbers of the double coordinates stay."""
    far = np.array([500_000.0, 5_400_000.0, 120.0])
    cameras, rows, points = model()
    write_colmap(tmp_path)
    plain = read_photographs(tmp_path)
    assert not plain.offset().any()
    rows = [(i, q, t - quaternion_rotation("", q) @ far, *more) for i, q, t, *more in rows]
    write_text(tmp_path / "sparse/0", cameras, rows, [(i, p + far, *more) for i, p, *more in points])
    taken = read_photographs(tmp_path)
    assert np.abs(taken.offset() - far).max() <= 2
    moved = taken.moved(taken.offset())
    shift = taken.offset() - far
    np.testing.assert_allclose(moved.points, plain.points - shift, atol=1e-8)
    np.testing.assert_allclose(moved.centres, plain.centres - shift, atol=1e-8)
    assert stated_offset(georeference(taken.offset())).tolist() == taken.offset().tolist()
    near, own = NamedCamera(translation=(0.5, 1.0, 0.0)), np.array([5e5, 5.4e6, 100.0])
    assert scene_offset(taken, near, np.zeros(3)).tolist() == taken.offset().tolist()
    assert scene_offset(taken, near, own).tolist() == own.tolist()
    assert not scene_offset(plain, near, own).any()


@pytest.mark.parametrize(
    "value",
    ["", "hello", "1 " * 15, "1 " * 17, "1 0 0 1e999 0 1 0 0 0 0 1 0 0 0 0 1", "2 0 0 5 0 1 0 0 0 0 1 0 0 0 0 1"],
)
def test_a_strange_georeference_is_none(value: str) -> None:
    """SPEC 6.14: a violation refuses no file, and no number of a file makes a place infinite."""
    assert stated_offset({"georeference": value}).tolist() == [0, 0, 0]


def test_binary_comes_before_text(tmp_path):
    write_colmap(tmp_path, write_text)
    write_binary(tmp_path / "sparse/0", *model(seed=1))
    np.testing.assert_array_equal(read_photographs(tmp_path).points, [p[1] for p in model(seed=1)[2]])


def test_images_without_pose_are_counted(made):
    write_images(made / "images", ["a.png", "deeper/b.jpg"])
    assert read_photographs(made).skipped == 2


def assert_scaled(before, after, check_size):
    """Cameras that project to the same places of smaller images. check_size: whether a width and a height are right."""
    points = np.random.default_rng(0).normal(size=(50, 3))
    for whole, part in zip(before, after, strict=True):
        c = part.camera
        assert check_size(c.width, c.height)
        assert part.image.shape == (c.height, c.width, 3)
        expected = project(whole.camera, points) * (c.width / WIDTH, c.height / HEIGHT)
        np.testing.assert_allclose(project(c, points), expected, rtol=1e-12)


def test_images_of_another_size_rescale_the_camera(made):
    before = everything(read_photographs(made))
    write_images(made / "images", [f"{i:02}.png" for i in range(COUNT)], 27, 20)
    assert_scaled(before, everything(read_photographs(made)), lambda *size: size == (27, 20))


def test_image_folder_is_chosen_by_size(tmp_path):
    write_colmap(tmp_path)
    names = [f"{i:02}.png" for i in range(COUNT)]
    for divisor in (2, 4):
        write_images(tmp_path / f"images_{divisor}", names, WIDTH // divisor, round(HEIGHT / divisor))
    (tmp_path / "images_notes").mkdir()

    def source(size):
        return everything(read_photographs(tmp_path, size))[3]

    for size, (width, height) in (
        (None, (40, 30)),
        (40, (40, 30)),
        (21, (40, 30)),
        (20, (20, 15)),
        (11, (20, 15)),
        (10, (10, 8)),
    ):
        expected = images.shrink(pixels(3, width, height), *images.wanted_size("", width, height, size))
        np.testing.assert_array_equal(source(size).image, expected)
    np.testing.assert_array_equal(source((10, 8)).image, pixels(3, 10, 8))
    np.testing.assert_array_equal(source((16, 12)).image, images.shrink(pixels(3, 20, 15), 16, 12))
    shutil.rmtree(tmp_path / "images")
    assert source(None).image.shape == (15, 20, 3)
    shutil.rmtree(tmp_path / "images_2")
    shutil.rmtree(tmp_path / "images_4")
    refused(tmp_path, "there is no image folder", "images_2")


# --- COLMAP's errors --------------------------------------------------------------------------------------------------


def test_no_folder(tmp_path):
    refused(tmp_path / "nowhere", "the folder does not exist")
    refused(tmp_path, "there are no cameras", "sparse/0/cameras.bin", "transforms.json")


@pytest.mark.parametrize("part", PARTS)
def test_every_truncation_of_binary(part, tmp_path):
    cameras, rows, points = model(2)
    write_colmap(tmp_path, write_binary, content=(cameras, rows, points[:3]))
    file = tmp_path / "sparse/0" / f"{part}.bin"
    whole = file.read_bytes()
    for length in range(len(whole)):
        file.write_bytes(whole[:length])
        refused(tmp_path, f"{part}.bin")
    file.write_bytes(whole + b"\0")
    refused(tmp_path, f"{part}.bin", "1 bytes follow")


def test_any_quaternion_length():
    q = np.array([0.5, -1.0, 2.0, 0.25])
    for scale in (1e-300, 1e-9, 1.0, 1e200):
        np.testing.assert_allclose(
            quaternion_rotation("", q * scale), Rotation.from_quat(q[[1, 2, 3, 0]]).as_matrix(), atol=1e-14
        )


@given(st.sampled_from(PARTS), st.integers(0, 10_000), st.binary(min_size=1, max_size=12))
def test_damaged_models(template, part, at, patch):
    """Whatever stands anywhere in a model's files: a set of photographs, or PhotographError."""
    (file,) = (template / "sparse/0").glob(f"{part}.*")
    whole = file.read_bytes()
    at %= len(whole)
    try:
        file.write_bytes(whole[:at] + patch + whole[at + len(patch) :])
        read_photographs(template)
    except PhotographError:
        pass
    finally:
        file.write_bytes(whole)


# --- image files ------------------------------------------------------------------------------------------------------


def test_image_that_shrinks_after_it_was_looked_at(made):
    photographs = read_photographs(made)
    write_images(made / "images", [f"{i:02}.png" for i in range(COUNT)], 20, 15)
    with pytest.raises(PhotographError, match="has changed"):
        photographs.train[0].image  # noqa: B018


@pytest.mark.parametrize(
    ("mode", "value", "expected"),
    [
        ("RGB", (10, 20, 30), (10, 20, 30)),
        ("L", 7, (7, 7, 7)),
        ("1", 1, (255, 255, 255)),
        ("RGBA", (10, 20, 30, 255), (10, 20, 30)),
        ("RGBA", (10, 20, 30, 0), (200, 100, 50)),
        ("RGBA", (100, 200, 30, 51), (180, 120, 46)),
        ("LA", (100, 51), (180, 100, 60)),
    ],
)
def test_kinds_of_pixels(tmp_path, mode, value, expected):
    Image.new(mode, (4, 3), value).save(tmp_path / "a.png")
    assert (images.read_image(tmp_path / "a.png", (200, 100, 50)) == expected).all()


def test_palette_with_a_transparent_entry(tmp_path):
    image = Image.new("P", (2, 1))
    image.putpalette([10, 20, 30, 40, 50, 60])
    image.putpixel((1, 0), 1)
    image.save(tmp_path / "a.png", transparency=1)
    assert images.read_image(tmp_path / "a.png", (1, 2, 3)).tolist() == [[[10, 20, 30], [1, 2, 3]]]


def test_orientation_is_not_applied(tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.fromarray(pixels(0)).save(tmp_path / "a.jpg", exif=exif)
    assert images.image_size(tmp_path / "a.jpg") == (WIDTH, HEIGHT)
    assert images.read_image(tmp_path / "a.jpg", (0, 0, 0)).shape == (HEIGHT, WIDTH, 3)


# --- sizes ------------------------------------------------------------------------------------------------------------


WRONG_SIZES = ("", "0", "0x3", "x", "4x", "-4", "4x5x6", "4.5", "999999", "4 x 5", "٤")
WRONG_COLOURS = ("", "grey", "1,2", "1,2,256", "1,2,-3", "1, 2, 3", "1,2,3,4", "\u0661,2,3")
COLOURS = {"white": (255, 255, 255), "255,255,255": (255, 255, 255), " black ": (0, 0, 0), "1,20,255": (1, 20, 255)}


@pytest.mark.parametrize(
    ("parse", "right", "wrong", "word"),
    [
        (parse_size, {"400x300": (400, 300), " 1600 ": 1600, "full": None}, WRONG_SIZES, "400x300"),
        (parse_background, {**COLOURS, "auto": None}, WRONG_COLOURS, "background"),
    ],
)
def test_texts_of_options(parse, right, wrong, word):
    assert {text: parse(text) for text in right} == right
    for text in wrong:
        with pytest.raises(PhotographError, match=word):
            parse(text)


@pytest.mark.parametrize("size", [(20, 15), (16, 12), (27, 20), 13, 1, 40])
def test_smaller_cameras_project_to_the_smaller_image(made, size):
    whole, part = (everything(read_photographs(made, wanted)) for wanted in (None, size))
    assert_scaled(whole, part, lambda *sides: sides == size if isinstance(size, tuple) else max(sides) == size)


def test_sizes_that_are_refused(made):
    refused(made, "20 x 20 would stretch", "20x15", size=(20, 20))
    refused(made, "not enlarged", "40x30", size=(80, 60))
    assert read_photographs(made, 400).train[0].camera.width == WIDTH


@pytest.mark.parametrize(("width", "height"), [(8, 6), (20, 15), (27, 20), (13, 10), (39, 29), (40, 7), (1, 1)])
def test_shrinking_averages_areas(width, height):
    """Against the definition: every source pixel cut into width x height equal parts, and the parts averaged."""
    image = pixels(5)
    fine = np.repeat(np.repeat(image, height, axis=0), width, axis=1).astype(np.float64)
    expected = fine.reshape(height, HEIGHT, width, WIDTH, 3).mean(axis=(1, 3))
    assert np.abs(images.shrink(image, width, height) - expected).max() <= 0.5 + 1e-3


# --- distortion -------------------------------------------------------------------------------------------------------

LENSES = {
    "barrel": (-0.2, 0.05, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    "pincushion": (0.15, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    "tangential": (0.0, 0.0, 0.01, -0.015, 0.0, 0.0, 0.0, 0.0),
    "higher": (-0.1, 0.02, 0.0, 0.0, -0.05, 0.0, 0.0, 0.0),
    "all": (-0.1, 0.02, -0.003, 0.004, 0.03, 0.02, -0.01, 0.02),
}


@pytest.mark.parametrize("name", LENSES)
def test_distortion_and_back(name):
    points = np.random.default_rng(0).uniform(-0.6, 0.6, (1000, 2))
    there = lens.distort(points, LENSES[name])
    assert np.abs(there - points).max() > 1e-3
    np.testing.assert_allclose(lens.undistort(there, LENSES[name]), points, atol=1e-12)


def test_distortion_by_hand():
    """x = 0.5, y = 0.25: r^2 = 0.3125."""
    at = lens.distort(np.array([[0.5, 0.25]]), (0.1, 0.2, 0.01, 0.02, 0.3, 0.4, 0.5, 0.6))
    radial = 1 + 0.1 * 0.3125 + 0.2 * 0.3125**2 + 0.3 * 0.3125**3
    radial /= 1 + 0.4 * 0.3125 + 0.5 * 0.3125**2 + 0.6 * 0.3125**3
    x = 0.5 * radial + 2 * 0.01 * 0.5 * 0.25 + 0.02 * (0.3125 + 2 * 0.25)
    y = 0.25 * radial + 0.01 * (0.3125 + 2 * 0.0625) + 2 * 0.02 * 0.5 * 0.25
    np.testing.assert_allclose(at, [[x, y]], rtol=1e-14)


def spots(camera, places):
    """An image with a soft spot of 3 pixels' deviation at each place [N, 2]."""
    y, x = np.indices((camera.height, camera.width)) + 0.5
    out = sum(np.exp(-((x - u) ** 2 + (y - v) ** 2) / 18) for u, v in places)
    return np.repeat(np.rint(np.clip(out, 0, 1) * 255).astype(np.uint8)[..., None], 3, axis=2)


def spot_near(image, place, reach=6):
    """The centre of mass of the brightness within `reach` pixels of a place."""
    y, x = np.indices(image.shape[:2]) + 0.5
    weight = image[..., 0] * (np.hypot(x - place[0], y - place[1]) < reach)
    return np.array([(weight * x).sum(), (weight * y).sum()]) / weight.sum()


@pytest.mark.parametrize("size", [None, 240, 150])
@pytest.mark.parametrize("name", LENSES)
def test_undistorted_spots_are_where_the_pinhole_camera_sees_them(name, size, tmp_path):
    """Points photographed through the lens by its formula are, after undistortion, where a pinhole projects them."""
    distortion, photographed = LENSES[name], Camera("", 320, 240, 300.0, 310.0, 165.0, 117.0, np.eye(3), np.zeros(3))
    points = np.stack(
        [*np.meshgrid(np.linspace(-0.4, 0.4, 7), np.linspace(-0.3, 0.3, 5)), np.ones((5, 7))], axis=2
    ).reshape(-1, 3)
    # The camera stands in the world with a pose of its own.
    content = model(2, ("FULL_OPENCV", 320, 240, (300.0, 310.0, 165.0, 117.0, *distortion)))
    write_text(tmp_path / "sparse/0", *content)
    seen = lens.distort(points[:, :2], distortion) * (300, 310) + (165, 117)
    (tmp_path / "images").mkdir()
    for row in content[1]:
        Image.fromarray(spots(photographed, seen)).save(tmp_path / "images" / row[4])
    photograph = read_photographs(tmp_path, size).train[0]
    c = photograph.camera
    assert (c.width, c.height) == ((320, 240) if size is None else (size, size * 3 // 4))
    expected = project(c, (points - c.translation) @ c.rotation)
    scale = 320 / c.width
    inside = ((expected > 15 / scale) & (expected < np.array([c.width, c.height]) - 15 / scale)).all(axis=1)
    assert inside.sum() >= 15
    places = np.array([spot_near(photograph.image, place, 12 / scale) for place in expected[inside]])
    error = np.abs(places - expected[inside]).max()
    assert error < 0.15, error
    # Without undistortion they would not be there.
    assert np.abs(seen / scale - expected).max() > 0.5


@pytest.mark.parametrize("name", LENSES)
def test_every_undistorted_pixel_was_photographed(name):
    photographed = Camera("", 320, 240, 300.0, 310.0, 165.0, 117.0, np.eye(3), np.zeros(3))
    camera = lens.undistorted_camera("", photographed, LENSES[name])
    y, x = np.indices((241, 321))
    plane = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy], axis=2).reshape(-1, 2)
    at = lens.distort(plane, LENSES[name]) * (300, 310) + (165, 117)
    assert (at > -1e-3).all()
    assert (at < np.array([320, 240]) + 1e-3).all()
    # None that fits is wasted: the frame touches the photograph's edge, unless its middle is off.
    assert min(at.min(axis=0).min(), (np.array([320, 240]) - at.max(axis=0)).min()) < 0.5
    white = lens.undistorted_image(np.full((240, 320, 3), 255, np.uint8), photographed, LENSES[name], camera)
    assert (white == 255).all()


@pytest.mark.parametrize(
    "distortion",
    [(-0.9, 0, 0, 0), (-3.0, 4.0, 0, 0), (0, 0, 5.0, 0), (500.0, 0, 0, 0), (1e300, 0, 0, 0), (0.0, 1e308, 0, 1e308)],
)
def test_distortion_that_cannot_be_undone(tmp_path, distortion):
    write_colmap(tmp_path, camera=("OPENCV", WIDTH, HEIGHT, (25, 25, 20, 15, *distortion)))
    stated = [name for name, value in zip(("k1", "k2", "p1", "p2"), distortion, strict=True) if value]
    refused(tmp_path, f"the distortion {', '.join(stated)} = ", "image_undistorter")


# --- transforms.json --------------------------------------------------------------------------------------------------


def looking_at_origin(count, distance=4.0, seed=0):
    """Camera-to-world matrices in Blender's convention: y up, looking along -z at the origin."""
    out = []
    for direction in np.random.default_rng(seed).normal(size=(count, 3)):
        back = direction / np.linalg.norm(direction)
        right = np.cross([0.1, 0.2, 1.0], back)
        right /= np.linalg.norm(right)
        matrix = np.eye(4)
        matrix[:3] = np.stack([right, np.cross(back, right), back, back * distance], axis=1)
        out.append(matrix)
    return out


def write_nerf(folder, name="transforms.json", prefix="images/", suffix=".png", count=COUNT, seed=0, **keys):
    frames = [
        {"file_path": f"{prefix}r_{i}", "transform_matrix": m.tolist()}
        for i, m in enumerate(looking_at_origin(count, seed=seed))
    ]
    write_images(folder, [f["file_path"] + suffix for f in frames])
    document = {"camera_angle_x": 0.8, **keys, "frames": frames}
    (folder / name).parent.mkdir(exist_ok=True)
    (folder / name).write_text(json.dumps(document))
    return document


@pytest.fixture
def nerf(tmp_path):
    write_nerf(tmp_path / "nerf")
    return tmp_path / "nerf"


def change(folder, edit_document, name="transforms.json"):
    document = json.loads((folder / name).read_text())
    edit_document(document)
    (folder / name).write_text(json.dumps(document))


def test_transforms(nerf):
    photographs = read_photographs(nerf)
    assert [p.camera.name for p in photographs.test] == ["images/r_0", "images/r_8"]
    assert len(photographs.train) == 8
    for i, (photograph, matrix) in enumerate(zip(everything(photographs), looking_at_origin(COUNT), strict=True)):
        c = photograph.camera
        np.testing.assert_allclose(c.centre, matrix[:3, 3], atol=1e-12)
        np.testing.assert_allclose(c.rotation @ c.rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(c.rotation) > 0
        focal = WIDTH / 2 / np.tan(0.4)
        np.testing.assert_allclose((c.fx, c.fy, c.cx, c.cy), (focal, focal, 20, 15))
        # The origin is in the middle; what Blender's camera has above it (+y) is above it in the image (smaller y).
        up, right = matrix[:3, 1] * 0.1, matrix[:3, 0] * 0.1
        np.testing.assert_allclose(
            project(c, np.stack([np.zeros(3), up, right])),
            [[20, 15], [20, 15 - focal / 40], [20 + focal / 40, 15]],
            atol=1e-9,
        )
        np.testing.assert_array_equal(photograph.image, pixels(i))


def test_random_points_are_in_the_box_and_repeat(nerf):
    photographs = read_photographs(nerf)
    assert photographs.points.shape == (transforms.RANDOM_POINTS, 3)
    # All cameras look at the origin from 4 away.
    assert 1.33 < np.abs(photographs.points).max() <= 4 / 3 + 1e-9
    assert np.abs(photographs.points.mean(axis=0)).max() < 0.02
    assert (photographs.colours == 128).all()
    np.testing.assert_array_equal(read_photographs(nerf).points, photographs.points)
    assert (read_photographs(nerf, seed=1).points != photographs.points).any()


def write_ply(file, points, colours=None, dtype="u1"):
    fields = [(n, "f4") for n in "xyz"] + (
        [(n, dtype) for n in ("red", "green", "blue")] if colours is not None else []
    )
    rows = np.array(
        [tuple(r) for r in (points if colours is None else np.concatenate([points, colours], axis=1)).tolist()], fields
    )
    PlyData([PlyElement.describe(rows, "vertex")]).write(str(file))


def test_points_of_a_ply_file(nerf):
    points, colours = np.arange(12.0).reshape(4, 3), np.arange(12).reshape(4, 3)
    write_ply(nerf / "points3d.ply", points, colours)
    photographs = read_photographs(nerf)
    np.testing.assert_array_equal(photographs.points, points)
    np.testing.assert_array_equal(photographs.colours, colours)
    assert (photographs.points.dtype, photographs.colours.dtype) == (np.float64, np.uint8)
    change(nerf, lambda d: d.update(ply_file_path="cloud.ply"))
    write_ply(nerf / "cloud.ply", points[:2])
    assert (read_photographs(nerf).colours == 128).all()


def test_own_split(tmp_path):
    """transforms_train.json alone is a list of images as any other: every eighth one is held out."""
    write_nerf(tmp_path, "transforms_train.json", "./train/")
    half = read_photographs(tmp_path)
    assert [p.camera.name for p in half.test] == [f"train/r_{i}" for i in range(0, COUNT, 8)]
    assert len(half.train) + len(half.test) == COUNT
    write_nerf(tmp_path, "transforms_test.json", "./test/", count=3, seed=1)
    photographs = read_photographs(tmp_path)
    assert [p.camera.name for p in photographs.train] == [f"train/r_{i}" for i in range(COUNT)]
    assert [p.camera.name for p in photographs.test] == [f"test/r_{i}" for i in range(3)]
    (tmp_path / "transforms_train.json").rename(tmp_path / "transforms.json.kept")
    refused(tmp_path, "transforms_train.json", "the file is missing")


def test_holdout(tmp_path):
    write_nerf(tmp_path)
    names = [f"images/r_{i}" for i in range(COUNT)]
    for every in (2, 3):
        photographs = read_photographs(tmp_path, holdout=every)
        assert [p.camera.name for p in photographs.test] == names[::every]
        assert sorted(p.camera.name for p in (*photographs.train, *photographs.test)) == names
    photographs = read_photographs(tmp_path, holdout=0)
    assert (len(photographs.train), photographs.test, photographs.random) == (COUNT, (), True)
    refused(tmp_path, "no image is left for training", holdout=1)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".jpeg", ".JPG"])
def test_file_path_with_and_without_extension(tmp_path, suffix):
    write_nerf(tmp_path, suffix=suffix)
    assert len(read_photographs(tmp_path).train) == 8
    change(tmp_path, lambda d: [f.update(file_path=f["file_path"] + suffix) for f in d["frames"]])
    assert read_photographs(tmp_path).train[0].camera.name == f"images/r_1{suffix}"


def test_intrinsics_of_file_and_frame(nerf):
    change(nerf, lambda d: d.update(fl_x=50, fl_y=51.5, cx=19, cy=16.5, w=40.0, h=30, camera_model="OPENCV", k1=0.0))
    change(nerf, lambda d: d["frames"][1].update(fl_x=60, cx=18))
    first, second = read_photographs(nerf).train[:2]
    assert (first.camera.fx, first.camera.fy, first.camera.cx, first.camera.cy) == (60, 51.5, 18, 16.5)
    assert (second.camera.fx, second.camera.fy, second.camera.cx, second.camera.cy) == (50, 51.5, 19, 16.5)
    change(nerf, lambda d: (d.pop("fl_y"), d.update(camera_angle_y=1.0)))
    assert read_photographs(nerf).train[1].camera.fy == pytest.approx(15 / np.tan(0.5))


def test_size_stated_for_larger_images(nerf):
    change(nerf, lambda d: d.update(w=400, h=300, fl_x=350))
    c = read_photographs(nerf).train[0].camera
    np.testing.assert_allclose((c.width, c.height, c.fx, c.fy, c.cx, c.cy), (40, 30, 35, 35, 20, 15))


def test_distorted_transforms_are_undistorted(nerf):
    change(nerf, lambda d: d.update(k1=-0.1, k2=0.01, p1=0.001, p2=-0.002, k3=0.003))
    camera = Camera("", 40, 30, *(20 / np.tan(0.4),) * 2, 20.0, 15.0, np.eye(3), np.zeros(3))
    expected = lens.undistorted_camera("", camera, (-0.1, 0.01, 0.001, -0.002, 0.003, 0, 0, 0))
    photograph = read_photographs(nerf).train[0]
    np.testing.assert_allclose((photograph.camera.fx, photograph.camera.cx), (expected.fx, expected.cx))
    assert photograph.image.shape == (30, 40, 3)


@pytest.mark.parametrize("make", [write_colmap, write_nerf])
def test_the_background_is_that_of_the_pictures(make, tmp_path):
    make(tmp_path)
    photographs = read_photographs(tmp_path)
    mean = tuple(np.rint(photographs.colours.mean(axis=0)))
    assert (photographs.background, photographs.opaque) == (mean, True)
    assert not read_photographs(tmp_path, background=(0, 0, 0)).opaque
    assert photographs.over((1, 2, 3)).train[0].background == (1, 2, 3)
    file = next((tmp_path / "images").glob("*.png"))
    image = Image.open(file).convert("RGBA")
    for alpha, background in ((255, mean), (254, (255, 255, 255))):
        image.putpixel((3, 2), (9, 9, 9, alpha))
        image.save(file)
        photographs = read_photographs(tmp_path)
        assert (photographs.background, photographs.opaque) == (background, alpha == 255)


def test_transparent_images(nerf):
    image = np.zeros((HEIGHT, WIDTH, 4), np.uint8)
    image[:, :20] = (10, 20, 30, 255)
    Image.fromarray(image).save(nerf / "images/r_1.png")
    for background, arguments in (((255, 255, 255), {}), ((0, 9, 99), {"background": (0, 9, 99)})):
        composited = read_photographs(nerf, 20, **arguments).train[0].image
        assert (composited[:, :10] == (10, 20, 30)).all()
        assert (composited[:, 10:] == background).all()


def test_frames_without_pose_are_counted(nerf):
    change(nerf, lambda d: [d["frames"][i].pop("transform_matrix") for i in (2, 5)])
    photographs = read_photographs(nerf)
    assert (photographs.skipped, len(photographs.train) + len(photographs.test)) == (2, 8)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inside: (
        st.lists(inside, max_size=4)
        | st.dictionaries(st.sampled_from(["frames", "file_path", "w"]), inside, max_size=3)
    ),
    max_leaves=20,
)
KEYS = ["frames", "ply_file_path", *transforms.TransformsFrame.__struct_fields__]


@pytest.fixture(scope="module")
def shared_nerf(tmp_path_factory):
    folder = tmp_path_factory.mktemp("nerf")
    write_ply(folder / "points3d.ply", np.ones((3, 3)))
    return folder, write_nerf(folder)


@given(st.sampled_from(KEYS), JSON, st.booleans())
def test_any_json(shared_nerf, key, value, of_frame):
    """Whatever a key holds: a set of photographs, or PhotographError."""
    folder, document = shared_nerf
    document = {**document, "frames": [dict(frame) for frame in document["frames"]]}
    (document["frames"][2] if of_frame else document)[key] = value
    (folder / "transforms.json").write_text(json.dumps(document))
    with contextlib.suppress(PhotographError):
        read_photographs(folder)


# --- folders and their faults -----------------------------------------------------------------------------------------


def in_text(part, old, new):
    """The first occurrence of a text in a file of the model is another one."""
    return lambda folder: edit(folder / "sparse/0" / f"{part}.txt", old, new)


def in_bytes(part, at, new):
    """Bytes of a file of the model at a place are others."""

    def put(folder):
        file = folder / "sparse/0" / f"{part}.bin"
        data = file.read_bytes()
        file.write_bytes(data[:at] + new + data[at + len(new) :])

    return put


def written(**changes):
    """The model has other rows: of image 4, or of point 3. Empty: the images or the points that there are not."""

    def write(folder):
        cameras, rows, points = model()
        i, q, t, c, name, seen = rows[4]
        rows[4] = (i, changes.get("quaternion", q), changes.get("translation", t), c, name, seen)
        k, place, rgb, e, track = points[3]
        points[3] = (k, changes.get("point", place), changes.get("colour", rgb), e, track)
        WRITERS[folder.name](
            folder / "sparse/0", cameras, rows[: changes.get("images")], points[: changes.get("points")]
        )

    return write


def without_part(part):
    return lambda folder: next((folder / "sparse/0").glob(f"{part}.*")).unlink()


def pictured(make):
    """An image of the folder is another one. make: receives its file."""
    return lambda folder: make(folder / "images/02.png")


def in_json(action):
    return lambda folder: change(folder, action)


def _set(key, value, frame=None):
    return in_json(lambda d: (d if frame is None else d["frames"][frame]).update({key: value}))


def cloud(*arguments):
    """A point cloud that ply_file_path names."""

    def write(folder):
        _set("ply_file_path", "cloud.ply")(folder)
        if arguments:
            write_ply(folder / "cloud.ply", *arguments)

    return write


def parallel(document):
    for i, frame in enumerate(document["frames"]):
        frame["transform_matrix"] = np.eye(4).tolist()
        frame["transform_matrix"][0][3] = i


def outward(document):
    for frame in document["frames"]:
        matrix = np.array(frame["transform_matrix"])
        matrix[:3, [0, 2]] *= -1
        frame["transform_matrix"] = matrix.tolist()


def turned_into_a_folder(folder):
    (folder / "sparse/0/points3D.txt").unlink()
    (folder / "sparse/0/points3D.txt").mkdir()


ROW, PARAMETERS = "7 PINHOLE 40 30 35.5 36.25 20.5 14.75\n", "PINHOLE 40 30 35.5 36.25 20.5 14.75"
GRID = np.arange(12.0).reshape(4, 3)
MANY = "ply\nformat binary_little_endian 1.0\nelement vertex 99999999999999\nproperty float x\nend_header\n"
OUTSIDE = ("../images/r_1", "images/../../r_1", "/images/r_1", "")
DEEP = np.full((HEIGHT, WIDTH), 40000, np.uint16)
# A part of a model in text, what stands there, what stands there instead, and words of the error.
LINES = [
    ("images", "03.png", "long" * 2000, "cannot be read", "too long"),
    ("cameras", "PINHOLE 40", "PINHOLE forty", "line 2", "CAMERA_ID MODEL WIDTH", "forty"),
    ("cameras", " 14.75", "", "3 parameters, but PINHOLE has 4"),
    ("cameras", "35.5", "nan", "focal length fx is nan", "0.4 to 40000"),
    ("cameras", "35.5", "0", "focal length fx is 0"),
    ("cameras", "36.25", "1e9", "focal length fy"),
    ("cameras", "20.5", "inf", "cx is inf"),
    ("cameras", "20.5", "2000", "principal point (2000, 14.75)"),
    ("cameras", PARAMETERS, "OPENCV 40 30 25 25 20 15 0 0 0 nan", "p2 is nan"),
    ("cameras", "40 30", "0 30", "0 x 30", "1 to 131072"),
    ("cameras", "7 PINHOLE", "7 EQUIRECTANGULAR", "EQUIRECTANGULAR is not", "SIMPLE_PINHOLE, PINHOLE"),
    ("cameras", "7 PINHOLE", "7 PINHOLES", "PINHOLES is not supported", "image_undistorter"),
    ("cameras", ROW, 2 * ROW, "camera 7 is defined twice"),
    ("cameras", "7 PINHOLE", "8 PINHOLE", "camera 7 is not in cameras.txt"),
    ("images", "00.png\n\n", "00.png\n", "line 3", "2D points", "second line"),
    ("images", " 01.png", "", "line 4", "IMAGE_ID QW"),
    ("images", "01.png", "../01.png", "'../01.png'", "names are relative to"),
    ("images", "01.png", "/01.png", "'/01.png'"),
    ("images", "01.png", "00.png", "two images are named '00.png'"),
    ("points3D", " 0.5 3 0 5 1", " 128 0.5 3 0 5 1", "points3D.txt, line 2", "a track has two"),
    ("points3D", " 0.5 3 0 5 1", ".5 3 3 0 5 1", "points3D.txt, line 2", "invalid literal"),
    ("points3D", " 0.5 3 0 5 1", "", "points3D.txt, line 2", "not enough values"),
]
# A part of a binary model, a place, the bytes there, and words of the error.
BYTES = [
    ("images", 12, struct.pack("<d", NAN), "images.bin, record 0 of 10", "NaN"),
    ("images", 484, b"\xff", "record 4 of 10", "not UTF-8"),
    ("images", 8 + 64 + 7, struct.pack("<Q", 1 << 60), "images.bin", "ends inside record 0 of 10"),
    ("points3D", 51, struct.pack("<Q", 1 << 60), "points3D.bin", "ends inside record 0 of 25"),
    ("cameras", 12, struct.pack("<i", 5), "OPENCV_FISHEYE is not supported", "image_undistorter"),
    *(
        (part, 0, struct.pack("<Q", n), f"{n} {part}", "at most")
        for part in PARTS
        for n in (1 << 20, 1 << 40, (1 << 64) - 1)
    ),
    ("cameras", 12, struct.pack("<i", 99), "number 99 is not supported", "supported models are"),
]
# A key of transforms.json, its value, the frame that has it or None, and words of the error.
ENTRIES = [
    # A document of others could have any picture of this machine put into a scene.
    *(("ply_file_path", name, None, "ply_file_path", repr(name), "file in the folder") for name in OUTSIDE),
    *((k, n, 0, "frame 0", k, repr(n), "file in the folder") for k in ("file_path", "mask_path") for n in OUTSIDE),
    ("mask_path", "images/none.png", 3, "none.png", "the image is missing"),
    ("camera_angle_x", 0, None, "camera_angle_x is 0"),
    ("camera_angle_x", 4, None, "camera_angle_x is 4"),
    ("camera_angle_x", NAN, None, "transforms.json", "a number is nan"),
    ("camera_angle_x", True, None, "camera_angle_x is True"),
    ("fl_x", 10**400, None, "transforms.json", "an integer has more than 40 digits"),
    ("fl_x", 0, None, "focal length fx is 0"),
    ("w", 40.5, None, "w is 40.5", "whole number"),
    ("w", 40 * 2, None, "r_1.png", "not the same shape"),
    ("h", -30, None, "40 x -30"),
    ("cx", INF, None, "transforms.json", "a number is inf"),
    ("k3", -1e3, None, "the distortion k3 = -1000 ", "undistort the images"),
    ("camera_model", "OPENCV_FISHEYE", None, "OPENCV_FISHEYE is not supported", "PINHOLE"),
    ("camera_model", ["OPENCV"], None, "is not supported"),
    ("is_fisheye", True, None, "fisheye is not supported"),
    ("file_path", "images/none", 3, "images/none", "missing"),
    ("file_path", "images/r_0", 3, "frame 3", "two images are named 'images/r_0'"),
    *(
        ("transform_matrix", value, 3, "frame 3", "not 4 rows of 4 numbers")
        for value in ("here", [[1, 0], [0, 1]], [[1], [0, 1]])
    ),
    ("transform_matrix", (2 * np.eye(4)).tolist(), 3, "frame 3", "last row"),
    ("transform_matrix", np.diag([2.0, 2, 2, 1]).tolist(), 3, "frame 3", "not a rotation", "2, 2, 2"),
    ("transform_matrix", np.diag([1.0, 1, -1, 1]).tolist(), 3, "frame 3", "not a rotation", "determinant -1"),
    ("transform_matrix", [[NAN] * 4] * 3, 3, "transforms.json", "a number is nan"),
    ("transform_matrix", [[1e200] * 4] * 3, 3, "frame 3", "not a rotation"),
]
# What puts another image into a file, and words of the error.
PICTURES = [
    (lambda file: file.write_text("hello"), "not a readable image", "JPEG, PNG"),
    (lambda file: file.write_bytes(file.read_bytes()[:1000]), "not a readable image", "truncated"),
    # PostScript is what Pillow would start a program for.
    (lambda file: Image.fromarray(pixels(0)).save(file, format="EPS"), "not a readable"),
    (lambda file: Image.fromarray(DEEP).save(file), "format is I", "8 bits"),
    (lambda file: Image.fromarray(pixels(0, 40, 28)).save(file), "not the same shape", "40 x 28"),
    (lambda file: Image.fromarray(pixels(0, 30, 40)).save(file), "not the same shape", "rotated"),
    (lambda file: Image.fromarray(pixels(0, 1, 1)).save(file), "the image has 1 x 1", "less than 1/16"),
    (lambda file: Image.fromarray(pixels(0, 80, 63)).save(file), "not the same shape", "40 x 30"),
]
# What is wrong in a COLMAP folder, in text or binary or both, or in a NeRF folder, and words of the error.
FAULTS = [
    *(("both", without_part(part), part, "is missing", "together") for part in PARTS),
    ("both", written(images=0), "images", "no image has a pose"),
    ("both", written(points=0), "points3D", "there are no points", "point_triangulator"),
    ("both", written(images=1), "no image is left for training", "1 are held out"),
    ("both", lambda f: [(f / f"images/{i}.png").unlink() for i in ("02", "05")], "02.png", "is missing", "2 of the 10"),
    *(("both", pictured(make), "02.png", *words) for make, *words in PICTURES),
    *(
        ("both", lambda f, v=v: [(f / "masks").mkdir(), Image.fromarray(v).save(f / "masks/02.png")], "masks/02", word)
        for v, word in ((DEEP, "format is I"), (DEEP < 0, "is everywhere"), (DEEP.T > 0, "not the shape of"))
    ),
    ("text", turned_into_a_folder, "points3D.txt", "directory"),
    ("text", lambda f: (f / "sparse/0/images.txt").write_bytes(b"\xff\xfe\x00"), "images.txt", "not text in UTF-8"),
    *(("text", in_text(*row[:3]), *row[3:]) for row in LINES),
    *(("text", written(quaternion=[1, v, 0, 0]), "images.txt, line 10", "NaN") for v in (NAN, INF)),
    ("text", written(translation=[1, NAN, 0]), "images.txt, line 10", "NaN"),
    ("text", written(quaternion=[0, 0, 0, 0]), "images.txt, line 10", "0 0 0 0"),
    *(("text", written(colour=[0, v, 0]), "points3D.txt", "outside 0 to 255") for v in (256, -1)),
    ("text", written(colour=[0, 10**400, 0]), "points3D.txt, line 5", "too large"),
    *(("binary", in_bytes(*row[:3]), *row[3:]) for row in BYTES),
    ("nerf", in_json(outward), "look away from each other", "points3d.ply"),
    ("nerf", in_json(parallel), "axes do not meet", "points3d.ply"),
    ("nerf", cloud(), "cloud.ply", "ply_file_path", "missing"),
    ("nerf", cloud(GRID, GRID, "f4"), "cloud.ply", "float32, but must be uint8"),
    ("nerf", cloud(GRID[:0]), "cloud.ply", "there are no points"),
    ("nerf", cloud(GRID * NAN), "4 points of 4 left out, NaN", "none is left"),
    ("nerf", lambda f: (f / "points3d.ply").write_text(MANY), "points3d.ply", "not a readable point cloud"),
    ("nerf", in_json(lambda d: [f.pop("transform_matrix") for f in d["frames"]]), "no image has a pose", "transform_m"),
    ("nerf", in_json(lambda d: d.pop("frames")), 'no list "frames"'),
    ("nerf", in_json(lambda d: d.pop("camera_angle_x")), "frame 0", "no focal length", "fl_x"),
    *(("nerf", _set(*row[:3]), *row[3:]) for row in ENTRIES),
]


@pytest.mark.parametrize(("kind", "fault", "words"), [(kind, fault, words) for kind, fault, *words in FAULTS])
def test_faults(kind, fault, words, tmp_path):
    for name in WRITERS if kind == "both" else [kind]:
        if name == "nerf":
            write_nerf(tmp_path / name)
        else:
            write_colmap(tmp_path / name, WRITERS[name])
        fault(tmp_path / name)
        refused(tmp_path / name, *words)


# --- the examples -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "train", "test"), [("caliterra", 65, 10), ("snowmiku", 84, 13)])
def test_examples(name, train, test):
    taken = read_photographs(EXAMPLES / name)
    assert (len(taken.train), len(taken.test), taken.skipped, taken.points.shape) == (train, test, 0, (12500, 3))
    assert (EXAMPLES / name / "LICENSE").is_file()
    assert (EXAMPLES / name / "SOURCE.md").is_file()
    for photograph in taken.train[:3]:
        assert photograph.image.shape == (300, 400, 3)
        at = project(photograph.camera, taken.points)
        depth = (taken.points @ photograph.camera.rotation.T + photograph.camera.translation)[:, 2]
        inside = (depth > 0) & (at > 0).all(axis=1) & (at < (400, 300)).all(axis=1)
        assert inside.sum() > 100
        # Most points have the colours of where they are seen (some are hidden), not those of the image upside down.
        x, y = at[inside].astype(int).T
        colours = taken.colours[inside].astype(int)
        own, other = (
            np.median(np.abs(image[y, x] - colours)) for image in (photograph.image, photograph.image[::-1, ::-1])
        )
        assert own < 0.7 * other


def test_reducing_tool(text, tmp_path):
    """What the tool writes is read back: the same cameras, points rounded to 6 digits, JPEG."""

    def reduced(source, target, *words):
        command = [sys.executable, ROOT / "examples" / "reduce_photographs.py", source, target, "--size", *words]
        done = subprocess.run(command, check=False, capture_output=True, text=True)
        return done.returncode, done.stderr

    assert reduced(text, tmp_path / "small", "20x15", "--points", "7")[0] == 0
    before, after = read_photographs(text, (20, 15)), read_photographs(tmp_path / "small")
    assert len(after.points) == 7
    for a, b in zip(everything(before), everything(after), strict=True):
        assert b.camera.name == a.camera.name.replace("png", "jpg")
        np.testing.assert_allclose(b.camera.rotation, a.camera.rotation, atol=1e-11)
        np.testing.assert_allclose(b.camera.translation, a.camera.translation, atol=1e-11)
        np.testing.assert_allclose((b.camera.fx, b.camera.cy), (a.camera.fx, a.camera.cy), rtol=1e-8)
        assert b.image.shape == a.image.shape
    held = {path: path.read_bytes() for path in text.rglob("*") if path.is_file()}
    assert "exists" in reduced(text, text, "20")[1]
    assert held == {path: path.read_bytes() for path in text.rglob("*") if path.is_file()}
    status, err = reduced(tmp_path / "none", tmp_path / "x", "20")
    assert (status, "the folder does not exist" in err, "Traceback" in err) == (1, True, False)


def test_the_manual_lists_the_lenses_that_are_read() -> None:
    """With their parameters, in their order; NeRF's format has the same ones."""
    page = (ROOT / "docs" / "photographs.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `([A-Z_]+)` \| ([\w, ]+) \|$", page, re.MULTILINE)
    read = {name: list(inspect.signature(make).parameters) for name, (_, make) in colmap.MODELS.items()}
    assert {name: parameters.split(", ") for name, parameters in rows} == read
    assert tuple(read) == transforms.MODELS
    assert len(rows) == len(read)
