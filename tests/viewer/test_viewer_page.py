"""The page in a browser: from the disk and without network, its pictures, its texts, and its errors."""

import base64
import io
import json
import unicodedata
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from random_scenes import flipped, random_scene

from conformance.cases.scenes import PLANELESS
from conformance.manifest import ImageOf, load
from conformance.runner.images import image_difference
from refcodec.bitstream.attributes import Attributes
from refcodec.bitstream.cameras import CAMERAS, cameras, emit_cameras
from refcodec.bitstream.codec import emit, parse
from refcodec.bitstream.errors import BitstreamError
from refcodec.bitstream.header import RenderInfo
from refcodec.bitstream.limits import MAIN
from refcodec.bitstream.metadata import with_metadata
from refcodec.bitstream.scene import Ancillary
from refcodec.cli.main import main
from refcodec.files.text import printable
from refcodec.rendering.view import pfm
from refcodec.viewer.bundle import bundle
from refcodec.viewer.page import page
from tests.chromium import BrowserError, Chromium

ROOT = Path(__file__).resolve().parents[2]
VALID = ROOT / "vectors" / "valid"


@pytest.fixture(autouse=True)
def _nothing_is_said(browser: Chromium) -> Iterator[None]:
    """The browser reports no fault of the page, whatever is tested."""
    browser.said.clear()
    yield
    assert browser.said == []


def _open(browser: Chromium, path: Path) -> None:
    browser.asked.clear()
    browser.open(path.as_uri())


def _show(browser: Chromium, folder: Path, data: bytes, name: str = "scene.c3gs") -> None:
    """Opens the page of a file, and waits until it is drawn. Raises BrowserError if the page refuses it."""
    _open(browser, _write(folder, data, name))
    browser.run("c3gs.settle()")


def _text(browser: Chromium, selector: str) -> str:
    return str(browser.run(f"document.querySelector({json.dumps(selector)}).innerText"))


def _write(folder: Path, data: bytes, name: str = "scene.c3gs") -> Path:
    path = folder / "scene.html"
    path.write_bytes(page(name, data))
    return path


def _key(browser: Chromium, letter: str, *kinds: str) -> None:
    """Presses and releases a key, or one of the two."""
    for kind in kinds or ("keyDown", "keyUp"):
        browser.ask("Input.dispatchKeyEvent", {"type": kind, "code": f"Key{letter}", "key": letter.lower()})


def _drag(browser: Chromium, start: int, end: int, y: int) -> None:
    for kind, x in (("mousePressed", start), ("mouseMoved", end), ("mouseReleased", end)):
        browser.ask("Input.dispatchMouseEvent", {"type": kind, "x": x, "y": y, "button": "left", "buttons": 1})


@pytest.fixture(scope="module")
def exported(
    trained: Path, photographs: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, dict[str, Path]]:
    """A page with photographs, and what `refcodec render` draws for their cameras, by their names."""
    for package in ("numba", "PIL", "scipy"):
        pytest.importorskip(package, reason="the pictures are compared with those of the extra render")
    folder = tmp_path_factory.mktemp("exported")
    output, images = folder / "scene.html", folder / "images"
    assert main(["export", str(trained), "-o", str(output), "--photographs", str(photographs)]) == 0
    assert main(["render", str(trained), "--cameras", str(photographs), "-o", str(images)]) == 0
    return output, {path.stem: path for path in images.rglob("*.png")}


@pytest.mark.slow
def test_the_page_draws_what_render_draws(browser: Chromium, exported: tuple[Path, dict[str, Path]]) -> None:
    """It is opened from the disk, asks for nothing, and its pictures from three cameras agree to 50 dB."""
    from PIL import Image  # noqa: PLC0415

    output, images = exported
    _open(browser, output)
    browser.run("c3gs.settle()")
    assert browser.run("c3gs.header.anchor_count") == 2182
    cameras = browser.run("c3gs.cameras.filter(({ isPhotograph }) => isPhotograph).map(({ name }) => name)")
    assert len(cameras) >= 2
    own = browser.run("c3gs.cameras.filter(({ isPhotograph }) => !isPhotograph).length")
    assert own == 1
    compared = 0
    for name in cameras[:3]:
        at = f"c3gs.cameras.find(({{ name }}) => name === {json.dumps(name)})"
        picture = browser.run(f"c3gs.picture({at})").partition(",")[2]
        made = np.asarray(Image.open(io.BytesIO(base64.b64decode(picture))).convert("RGB"), np.float64)
        right = np.asarray(Image.open(images[Path(name).stem]), np.float64)
        assert made.shape == right.shape
        assert right.std() > 10
        psnr = 10 * np.log10(255**2 / np.mean((made - right) ** 2))
        assert psnr > 50, f"{name}: {psnr:.1f} dB"
        compared += 1
    assert compared == 3
    outside = [url for url in browser.asked if not url.startswith(("file:", "blob:", "data:"))]
    assert outside == []
    assert output.as_uri() in browser.asked


@pytest.mark.slow
@pytest.mark.requirement("G14.5-1")
def test_the_page_passes_the_image_vectors(browser: Chromium, tmp_path: Path) -> None:
    from PIL import Image  # noqa: PLC0415

    suite, before = load(), None
    for v in sorted((v for v in suite.vectors if isinstance(v.expectation, ImageOf)), key=lambda v: v.input.path):
        assert isinstance(v.expectation, ImageOf)
        if v.input != before:
            _show(browser, tmp_path, suite.path(v).read_bytes())
        before, camera = v.input, v.expectation.camera
        camera = {**camera, "rotation": [x for row in camera["rotation"] for x in row]}
        picture = browser.run(f"c3gs.picture({json.dumps(camera)})").partition(",")[2]
        made = np.asarray(Image.open(io.BytesIO(base64.b64decode(picture))).convert("RGB"), np.float32) / 255
        assert image_difference((suite.folder / v.expectation.path).read_bytes(), pfm(made)) is None, v.id


@pytest.mark.slow
def test_photographs_lie_over_the_scene(browser: Chromium, exported: tuple[Path, dict[str, Path]]) -> None:
    _open(browser, exported[0])
    browser.run("c3gs.settle()")
    assert browser.run("document.getElementById('slider').hidden")
    browser.run("document.querySelector('#after').click()")
    browser.run("c3gs.settle()")
    assert not browser.run("document.getElementById('slider').hidden")
    assert browser.run("document.querySelector('#photograph img').decode().then(() => true)")
    browser.run(
        "const s = document.querySelector('#slider input'); s.value = 0.25; s.dispatchEvent(new Event('input'))"
    )
    browser.until("document.querySelector('#photograph img').style.clipPath.includes('25%')")
    # The camera moves, so that the photograph is no more that of the view.
    _drag(browser, 300, 330, 100)
    browser.until("document.getElementById('slider').hidden")


def test_what_the_page_says(browser: Chromium, trained: Path, tmp_path: Path) -> None:
    """Title, author, licence and the bytes of each part. Text of the file is never more than text."""
    scene = parse(trained.read_bytes()).scene
    title = "</script><img src=x onerror=alert(1)>"
    entries = {"title": title, "author": "A. Author", "licence": "CC-BY-4.0"}
    data = emit(replace(scene, ancillary=with_metadata(scene.ancillary, entries)))
    _show(browser, tmp_path, data, name="</script><b>x")
    assert _text(browser, "#title") == title
    assert _text(browser, "#credit") == "A. Author · licence CC-BY-4.0"
    browser.run("document.getElementById('sizes').click()")
    rows = [line.split("\t") for line in _text(browser, "#share").splitlines()]
    sizes = {row[0]: int(row[1].replace(",", "")) for row in rows}
    assert sizes.pop("file") == len(data) == sum(sizes.values())
    assert sizes["weights of the networks"] == 22281
    assert _text(browser, "#files tbody") == f"</script><b>x\t{len(data):,}\t1.0 times\t"


def test_what_the_page_saves(browser: Chromium, tmp_path: Path) -> None:
    """The file, and splats of the same command, with their sizes: the same bytes as on the disk."""
    file, page, splats = VALID / "static-degree-1.c3gs", tmp_path / "a.html", tmp_path / "a.spz"
    assert main(["export", str(file), "-o", str(page), "-o", str(splats)]) == 0
    _open(browser, page)
    browser.run("c3gs.settle()")
    browser.run("document.getElementById('sizes').click()")
    first, other = (line.split("\t") for line in _text(browser, "#files tbody").splitlines())
    size, more = (path.stat().st_size for path in (file, splats))
    assert first == [file.name, f"{size:,}", "1.0 times", ""]
    assert other == [splats.name, f"{more:,}", f"{more / size:.1f} times", ""]
    # A click saves the bytes of a blob.
    browser.run("self.saved = []; URL.createObjectURL = (blob) => { saved.push(blob); return '#' }")
    browser.run("document.querySelectorAll('#files button').forEach((button) => button.click())")
    text = "btoa(String.fromCharCode(...new Uint8Array(await blob.arrayBuffer())))"
    read = f"Promise.all(saved.map(async (blob) => {text}))"
    assert [base64.b64decode(text) for text in browser.run(read)] == [path.read_bytes() for path in (file, splats)]


def test_texts_that_cannot_be_shown(browser: Chromium, trained: Path, tmp_path: Path) -> None:
    """The page and its window show escapes for what is not printable, and a bounded part of what is long."""
    steering = "a\u202eb\x1b[31m\x07\u2066\n"
    scene = parse(trained.read_bytes()).scene
    entries = dict.fromkeys(("title", "author", "licence", "source"), steering + "T" * 9000)
    named = [replace(camera, name=steering + camera.name) for camera in cameras(scene.ancillary)]
    assert named
    ancillary = (*with_metadata((), entries), Ancillary(CAMERAS, 0, emit_cameras(named)))
    _show(browser, tmp_path, emit(replace(scene, ancillary=ancillary)), name=steering)
    shown = [browser.run("document.title")]
    shown += [browser.run(f"document.querySelector('{at}').textContent") for at in ("#title", "#credit", "option")]
    assert all(text.isprintable() and printable(steering) in text and len(text) < 300 for text in shown)
    assert browser.run("document.getElementById('head').offsetHeight") < 200
    # The name of a file is shown with the reason why it is refused.
    browser.run(f"c3gs.open({{ input: new Uint8Array(9), name: {json.dumps(steering * 2000)} }}).then(() => {{}})")
    browser.until("!document.getElementById('error').hidden")
    shown = [browser.run("document.title"), browser.run("document.getElementById('title').textContent")]
    assert all(text.isprintable() and printable(steering) in text and len(text) < 300 for text in shown)


def test_cameras_near_the_default_come_first(browser: Chromium, trained: Path, tmp_path: Path) -> None:
    scene = parse(trained.read_bytes()).scene
    listed = [replace(next(iter(cameras(scene.ancillary))), name=f"{x}", translation=(x, 0, 9)) for x in (5, 40, 6, -9)]
    _show(browser, tmp_path, emit(replace(scene, ancillary=(Ancillary(CAMERAS, 0, emit_cameras(listed)),))))
    assert browser.run("c3gs.cameras.map(({ name }) => name)") == ["5", "6", "-9", "40"]


def test_the_rule_for_texts(browser: Chromium) -> None:
    """It is that of refcodec.files.text, for the characters that both know: those of Unicode 3.2, and surrogates."""
    script = bundle(ROOT / "refcodec" / "viewer" / "text.js")
    browser.open("about:blank")
    ranges = "Array.from({ length: 0x110000 }, (_, code) => String.fromCodePoint(code))"
    shown = browser.run(
        f"(() => {{ {script}; return JSON.stringify({ranges}.map((c) => module_viewer_text.printable(c, 99))); }})()"
    )
    differing = [
        code
        for code, text in enumerate(json.loads(shown))
        if unicodedata.ucd_3_2_0.category(chr(code)) != "Cn" and text != printable(chr(code))
    ]
    assert differing == []
    cut = browser.run(f"(() => {{ {script}; return module_viewer_text.printable('\U0001f600\x1b'.repeat(99), 7); }})()")
    assert cut == "\U0001f600\\x1b\U0001f600\\\N{HORIZONTAL ELLIPSIS}"


def test_a_damaged_file(browser: Chromium, trained: Path, tmp_path: Path) -> None:
    """The page says what refcodec says: code, clause and offset. Nothing of the scene stays."""
    data = flipped(trained.read_bytes(), -1000)
    with pytest.raises(BitstreamError) as refused:
        parse(data)
    verdict = json.loads(refused.value.to_json())
    with pytest.raises(BrowserError, match=str(verdict["code"])):
        _show(browser, tmp_path, data)
    message = _text(browser, "#error")
    assert "damaged" in message
    for part in (str(verdict["code"]), verdict["name"], f"SPEC.md {verdict['clause']}", f"byte {verdict['offset']}"):
        assert part in message
    assert browser.run("c3gs.drawing.count") == 0


def test_the_first_error_in_the_file(browser: Chromium, tmp_path: Path) -> None:
    """Several workers decode, and the page says what refcodec says, whichever of them fails first. Then they end."""
    (tmp_path / "none.html").write_bytes(page("none"))
    _open(browser, tmp_path / "none.html")
    for path in sorted((ROOT / "vectors").glob("*/order-of-*chunk*.c3gs")):
        with pytest.raises(BitstreamError) as refused:
            parse(path.read_bytes())
        browser.run(f"c3gs.open({{ input: {_input(path.read_bytes())}, name: '' }})")
        with pytest.raises(BrowserError) as said:
            browser.run("c3gs.settle()")
        verdict = json.loads(refused.value.to_json())
        assert all(f'"{name}":{verdict[name]}' in str(said.value) for name in ("code", "offset")), path.name
    assert browser.run("c3gs.workers.length") == 0


@pytest.mark.parametrize(
    ("name", "budget", "kept"),
    [("trained-caliterra", 3000, 6120), ("static-lengths", 60, 122), ("chunks-packed", 3, 59)],
)
def test_a_budget(name: str, budget: int, kept: int, browser: Chromium, tmp_path: Path) -> None:
    """At most so many Gaussians are drawn, and the page says so, and which chunks have none. Those that decode end."""
    path = _write(tmp_path, (VALID / f"{name}.c3gs").read_bytes())
    drawn = {}
    for most in (kept, budget):
        browser.open(f"{path.as_uri()}?budget={most / 10}e1")
        browser.run("c3gs.settle()")
        drawn[most] = browser.run("c3gs.drawing.count")
        said = f"The {most:,} most visible of {kept:,} Gaussians" if most < kept else ""
        assert _text(browser, "#left").startswith(said)
        assert bool(said) == bool(_text(browser, "#left"))
        assert browser.run("c3gs.workers.length") == 1
    assert drawn[budget] <= budget
    assert drawn[budget] > 0.7 * min(drawn[kept], budget) or name == "chunks-packed"
    assert ("none of" in _text(browser, "#left")) == (name == "chunks-packed")


def test_a_file_that_needs_too_much_memory(browser: Chromium, tmp_path: Path) -> None:
    """Memory of Gaussians counts before it is taken: this file has 5 MB and fewer anchors than the page allows."""
    count, d = 340_000, replace(PLANELESS, offset_count=16, render_width=128)
    scene = random_scene(1, 0, d, gain=0, profile=MAIN, chunk_size=1 << 14)
    few = scene.attributes

    def rows(array: np.ndarray, value: int = 0) -> np.ndarray:
        return np.full((count, *array.shape[1:]), value, array.dtype)

    attributes = Attributes(rows(few.features), rows(few.scalings), rows(few.offsets), rows(few.steps, 32))
    mask_model = np.full_like(scene.mask_model, (1 << 14) - 1)
    positions, masks = rows(scene.positions), rows(scene.masks, 1)
    scene = replace(scene, positions=positions, masks=masks, mask_model=mask_model, attributes=attributes)
    with pytest.raises(BrowserError, match="bytes of memory"):
        _show(browser, tmp_path, emit(scene))
    assert "memory" in _text(browser, "#error")
    assert browser.run("c3gs.header === undefined")


@pytest.mark.parametrize(
    ("data", "parts"),
    [
        (
            b"ply\nformat ascii 1.0\n",
            ["not a C3GS file", "looks like a PLY file", "--fast", "refcodec encode", "error 102"],
        ),
        (b"\x1f\x8b" + bytes(99), ["not a C3GS file", "looks like an SPZ file", "refcodec convert"]),
        (b"PK\3\4" + bytes(99), ["not a C3GS file", "ZIP", "refcodec convert"]),
        (b"<!DOCTYPE html>", ["not a C3GS file", "looks like a web page", "error 101"]),
        (b"a text of somebody, neither this nor that", ["not a C3GS file", "another kind"]),
        (b"", ["not a C3GS file", "It is empty", "error 101"]),
        (b"\x89C3GS\r\n\x1a\0\0", ["incomplete", "download it again", "error 101"]),
    ],
)
def test_files_of_other_kinds(data: bytes, parts: list[str], browser: Chromium, tmp_path: Path) -> None:
    """A file that is none of C3GS is not called damaged, whether it is chosen or lies in the page."""
    if data:
        _open(browser, _write(tmp_path, data))
    else:
        (tmp_path / "none.html").write_bytes(page("none"))
        _open(browser, tmp_path / "none.html")
        browser.run("c3gs.open({ input: new Blob([]), name: 'none' }).then(() => {})")
    browser.until("!document.getElementById('error').hidden")
    text = _text(browser, "#error")
    assert all(words in text for words in parts)
    assert "damaged" not in text
    # The next file can be opened right there.
    assert "Open another file" in text
    # A browser shows its dialog to people only.
    browser.run("document.getElementById('file').onclick = (event) => (event.preventDefault(), globalThis.asked = 1)")
    browser.run("document.querySelector('#error button').click()")
    assert browser.run("globalThis.asked") == 1


@pytest.mark.parametrize(("name", "anchors"), [("valid/empty", 0), ("tiny-example", 5)])
def test_small_files(name: str, anchors: int, browser: Chromium, tmp_path: Path) -> None:
    """A scene without anchors is an image of the background."""
    _show(browser, tmp_path, (ROOT / "vectors" / f"{name}.c3gs").read_bytes())
    assert browser.run("c3gs.header.anchor_count") == anchors


@pytest.mark.requirement("G6.5-2")
@pytest.mark.parametrize(("transfer", "shown"), [(13, [128, 64, 255]), (8, [188, 137, 255]), (99, [128, 64, 255])])
def test_linear_light_is_encoded(transfer: int, shown: list[int], browser: Chromium, tmp_path: Path) -> None:
    """SPEC 6.5: transfer characteristics 8 are linear light. Others are shown as those of sRGB."""
    render = RenderInfo(background=(128, 64, 255), transfer_characteristics=transfer)
    _show(browser, tmp_path, emit(random_scene(1, 0, PLANELESS, render=render)))
    assert np.abs(_edge(browser).reshape(-1, 3).astype(int) - shown).max() <= 1


@pytest.mark.requirement("G6.5-1")
def test_other_render_models_are_not_drawn(browser: Chromium, tmp_path: Path) -> None:
    render = RenderInfo(background=(128, 64, 255), render_model=7)
    with pytest.raises(BrowserError, match="render_model"):
        _show(browser, tmp_path, emit(random_scene(1, 5, PLANELESS, render=render)))
    assert "render_model is 7" in _text(browser, "#error")
    assert not _edge(browser).any()


def test_it_moves(browser: Chromium, trained: Path, tmp_path: Path) -> None:
    """Dragging turns around the scene, keys fly, and R comes back."""
    _show(browser, tmp_path, trained.read_bytes())
    start = browser.run("c3gs.pose")
    _drag(browser, 300, 360, 200)
    browser.run("c3gs.settle()")
    turned = browser.run("c3gs.pose")
    way = [np.subtract(turned["centre"], start["centre"]), np.array(turned["rotation"]).reshape(3, 3)]
    assert np.linalg.norm(way[0]) > 0.01
    assert np.allclose(way[1] @ way[1].T, np.eye(3), atol=1e-9)
    points = [np.add(p["centre"], p["pivot"] * np.array(p["rotation"][6:])) for p in (start, turned)]
    assert np.allclose(*points, atol=1e-6)
    _key(browser, "W", "keyDown")
    browser.until(f"c3gs.pose.centre[2] !== {turned['centre'][2]}")
    _key(browser, "W", "keyUp")
    _key(browser, "R", "keyDown")
    browser.run("c3gs.settle()")
    assert browser.run("c3gs.pose") == start


def test_a_double_click(browser: Chromium, trained: Path, tmp_path: Path) -> None:
    """What it meets comes to the middle, and the camera turns around it from where it was."""
    _show(browser, tmp_path, trained.read_bytes())
    start = browser.run("c3gs.pose")
    for count in (1, 2):
        for kind in ("mousePressed", "mouseReleased"):
            at = {"type": kind, "x": 200, "y": 160, "button": "left", "clickCount": count}
            browser.ask("Input.dispatchMouseEvent", at)
    browser.until("c3gs.camera === undefined")
    end = browser.run("c3gs.pose")
    lens = browser.run("c3gs.lens")
    assert end["centre"] == start["centre"]
    before, after = (np.array(pose["rotation"]).reshape(3, 3) for pose in (start, end))
    assert np.allclose(after @ after.T, np.eye(3), atol=1e-9)
    # The direction of the click, in the frame of the camera of before.
    scale = max(640 / lens["width"], 480 / lens["height"])
    middle = before @ after[2]
    assert 0.01 < end["pivot"] < 1000
    assert middle[0] < 0
    assert middle[1] < 0
    assert abs(middle[0] / middle[2] * lens["focal"][0] * scale - (200 - 320)) < 40


def test_the_tools(browser: Chromium, trained: Path, tmp_path: Path) -> None:
    """Help, a button for each tool, and no frame around the page after a key. All of it is within a phone's page."""
    _show(browser, tmp_path, trained.read_bytes())
    start = browser.run("c3gs.pose")
    is_open = "document.getElementById('help').open"
    # While the help is open, keys do nothing else.
    _key(browser, "H")
    assert browser.run(is_open)
    assert "save a picture" in _text(browser, "#help")
    _key(browser, "W")
    assert browser.run("c3gs.pressed.size") == 0
    browser.run("document.querySelector('#help button').click()")
    assert not browser.run(is_open)
    browser.run("document.querySelector('[data-key=KeyH]').click()")
    assert browser.run(is_open)
    browser.run("document.querySelector('#help button').click()")
    browser.run("c3gs.changed({ ...c3gs.pose, centre: [1, 2, 3] })")
    browser.run("document.querySelector('[data-key=KeyR]').click(), c3gs.settle()")
    assert browser.run("c3gs.pose") == start
    browser.run("c3gs.canvas.focus()")
    _key(browser, "R")
    assert browser.run("getComputedStyle(c3gs.canvas).outlineStyle") == "none"
    seen = "[...document.querySelectorAll('button, select, input, canvas')].filter((e) => e.checkVisibility())"
    named = f"{seen}.map((e) => e.ariaLabel ?? e.textContent.trim())"
    assert all(browser.run(named))
    browser.ask(
        "Emulation.setDeviceMetricsOverride", {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": True}
    )
    try:
        boxes = browser.run(
            "['head', 'tools', 'cameras', 'sizes'].map((id) => document.getElementById(id).getBoundingClientRect())"
            ".map(({ left, top, right, bottom }) => [left, top, right, bottom])"
        )
        for i, (left, top, right, bottom) in enumerate(boxes):
            assert 0 <= left < right <= 390
            assert 0 <= top < bottom <= 844
            assert all(right <= a or c <= left or bottom <= b or d <= top for a, b, c, d in boxes[i + 1 :])
    finally:
        screen = {"width": 640, "height": 480, "deviceScaleFactor": 1, "mobile": False}
        browser.ask("Emulation.setDeviceMetricsOverride", screen)


def _input(data: bytes) -> str:
    """A script for the bytes of a file."""
    text = json.dumps(base64.b64encode(data).decode())
    return f"Uint8Array.from(atob({text}), (letter) => letter.charCodeAt(0))"


def _edge(browser: Chromium) -> np.ndarray:
    """The left edge of a screenshot, below the title and above the buttons: the page says nothing there."""
    image_module = pytest.importorskip("PIL.Image", reason="screenshots need the packages of the extra render")
    shown = np.asarray(image_module.open(io.BytesIO(browser.screenshot())).convert("RGB"))
    return shown[120:400, :20]


def test_a_file_after_another(browser: Chromium, trained: Path, tmp_path: Path) -> None:
    """Of two files that are chosen at once, the last one is shown. A refused one leaves nothing of those before it."""
    good = trained.read_bytes()
    empty = (VALID / "empty.c3gs").read_bytes()
    _show(browser, tmp_path, good)
    assert _edge(browser).std() > 1
    # A key is held meanwhile. Both begin before either has a worker.
    _key(browser, "W", "keyDown")
    first, last = (f"c3gs.open({{ input: {_input(data)}, name: '{len(data)}' }})" for data in (good, empty))
    browser.run(f"c3gs.code = undefined; c3gs.wasm = undefined; {first}; {last}")
    browser.until("c3gs.header !== undefined")
    _key(browser, "W", "keyUp")
    browser.run("c3gs.settle()")
    assert browser.run("[c3gs.name, c3gs.header.anchor_count]") == [str(len(empty)), 0]
    browser.run(f"c3gs.open({{ input: {_input(good)}, name: 'good' }})")
    browser.run("c3gs.settle()")
    assert _edge(browser).std() > 1
    browser.run(f"c3gs.open({{ input: {_input(flipped(good, -1000))}, name: 'bad' }})")
    with pytest.raises(BrowserError, match="clause"):
        browser.run("c3gs.settle()")
    assert not _edge(browser).any()


def test_the_device_is_lost(browser: Chromium, trained: Path, tmp_path: Path) -> None:
    """The page says so, also for a file that is chosen later. Both return with it, to the camera of before."""
    _show(browser, tmp_path, trained.read_bytes())
    browser.run("c3gs.changed({ ...c3gs.pose, centre: c3gs.pose.centre.map((x) => x + 0.25) }); c3gs.settle()")
    before = browser.run("[c3gs.pose, c3gs.drawing.count]"), _edge(browser)
    browser.run("globalThis.device = c3gs.drawing.gl.getExtension('WEBGL_lose_context')")
    # The second time it is lost while the scene loads.
    for _ in range(2):
        browser.run("device.loseContext()")
        browser.until("!document.getElementById('error').hidden")
        assert "device was lost" in _text(browser, "#error")
        assert "file" not in _text(browser, "#error").partition("Open another file")[0]
        with pytest.raises(BrowserError, match="lost"):
            browser.run("c3gs.settle()")
        browser.run("device.restoreContext()")
        browser.until("document.getElementById('error').hidden")
    browser.run("c3gs.settle()")
    assert browser.run("[c3gs.pose, c3gs.drawing.count]") == before[0]
    assert (_edge(browser) == before[1]).all()
    browser.run("device.loseContext()")
    browser.until("!document.getElementById('error').hidden")
    browser.run(f"c3gs.open({{ input: {_input((VALID / 'empty.c3gs').read_bytes())}, name: 'next' }})")
    with pytest.raises(BrowserError, match="lost"):
        browser.run("c3gs.settle()")
    assert _text(browser, "#title") == "next"
    browser.run("device.restoreContext()")
    browser.until("c3gs.header !== undefined")
    browser.run("c3gs.settle()")
    assert browser.run("c3gs.header.anchor_count") == 0
