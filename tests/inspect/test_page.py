"""inspect --html: the page agrees with the file and with inspect's JSON, and a file cannot inject markup into it."""

import base64
import hashlib
import re
from collections import Counter, defaultdict
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from random_scenes import random_scene

from conformance.cases.scenes import CONSTANT, MAIN_DIMENSIONS, PLANELESS, TINY_DIMENSIONS, UNENCODED
from refcodec.bitstream.cameras import CAMERAS, NamedCamera, emit_cameras
from refcodec.bitstream.codec import emit, parse
from refcodec.bitstream.metadata import METADATA, emit_metadata
from refcodec.bitstream.scene import Ancillary
from refcodec.cli.main import main
from refcodec.inspect.page import file_map, measures
from refcodec.inspect.summary import document

EXAMPLE = Path(__file__).resolve().parents[2] / "vectors" / "tiny-example.c3gs"
# Elements of HTML that have no end.
VOID = {"meta", "img", "br", "link", "input"}
HOSTILE = "</title></style><script>alert('x')</script><img src=x onerror=alert(2)>\x1b[31m"


class Read(HTMLParser):
    """A page that was read.

    wrong: elements that do not end where they should. found: how often there is each element. links: what elements
    refer to. values: of `data` elements, by the id of their table or section. pieces: of the map, (inner, bytes).
    words: the text, by the id of its section or table.
    """

    def __init__(self, page: bytes) -> None:
        super().__init__()
        self.open: list[tuple[str, dict[str, str | None]]] = []
        self.wrong: list[str] = []
        self.found: Counter[str] = Counter()
        self.links: list[str] = []
        self.handlers: list[str] = []
        self.values: dict[str, list[float]] = defaultdict(list)
        self.pieces: list[tuple[bool, int]] = []
        self.words: dict[str, str] = defaultdict(str)
        self.feed(page.decode())
        self.close()
        self.wrong += [name for name, _ in self.open]

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.found[tag] += 1
        self.links += [str(given[name]) for name in ("src", "href", "action", "data") if name in given]
        self.handlers += [name for name in given if name.startswith("on")]
        if tag == "data":
            self.values[self._id()].append(float(str(given["value"])))
        if "piece" in str(given.get("class")).split():
            inner = any(str(a.get("class")) == "row" for _, a in self.open)
            self.pieces.append((inner, int(str(given["data-bytes"]))))
        if tag not in VOID:
            self.open.append((tag, given))

    def _id(self) -> str:
        return next((str(given["id"]) for _, given in reversed(self.open) if given.get("id")), "")

    def handle_endtag(self, tag: str) -> None:
        if not self.open or self.open.pop()[0] != tag:
            self.wrong.append(f"/{tag}")

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found[tag] += 1

    def handle_data(self, data: str) -> None:
        self.words[self._id()] += data


def cameras(count: int, name: str = "view") -> Ancillary:
    """Cameras in a row that look along z."""
    every = [
        NamedCamera(f"{name} {i}", 80, 60, (70.0, 70.0), (40.0, 30.0), translation=(i - count / 2, 0.0, 3.0))
        for i in range(count)
    ]
    return Ancillary(CAMERAS, 0, emit_cameras(every), 0)


@pytest.fixture(scope="module")
def data() -> bytes:
    """A scene of the shape of a trained one, with metadata and cameras."""
    scene = random_scene(4, 900, MAIN_DIMENSIONS, chunk_size=256)
    known = Ancillary(METADATA, 0, emit_metadata({"title": "A scene", "encoder": "a test"}), 0)
    return emit(replace(scene, ancillary=(known, cameras(20))))


def made(data: bytes, folder: Path, name: str = "scene.c3gs") -> bytes:
    """The page of a file."""
    (folder / name).write_bytes(data)
    assert main(["inspect", str(folder / name), "--html", str(folder / "page.html")]) == 0
    return (folder / "page.html").read_bytes()


@pytest.mark.parametrize(
    "scene",
    [
        random_scene(1, 0),
        random_scene(2, 1),
        random_scene(3, 90, chunk_size=4),
        random_scene(5, 30, PLANELESS),
        random_scene(6, 30, UNENCODED, spread=2000.0),
        random_scene(7, 30, CONSTANT, spread=0.0),
        random_scene(8, 60, TINY_DIMENSIONS, keep=0.0),
        random_scene(9, 60, TINY_DIMENSIONS, ancillary=(cameras(1), Ancillary(b"noTE", 3, b"abc", 2))),
        random_scene(9, 60, TINY_DIMENSIONS, ancillary=(cameras(40),)),
        random_scene(9, 60, TINY_DIMENSIONS, positions=np.zeros((60, 3), np.float16)),
    ],
)
def test_scenes_of_all_kinds_have_a_page(scene, tmp_path: Path) -> None:
    page = Read(made(emit(scene), tmp_path))
    assert page.wrong == []
    assert page.found["section"] == 6
    assert "nan" not in "".join(page.words.values()).split()


def assert_harmless(page: Read) -> None:
    """It ends all its elements, refers to nothing outside, and has one script."""
    assert page.wrong == []
    assert page.links
    assert all(link.startswith(("data:image/png;base64,", "#")) for link in page.links)
    assert page.found["script"] == 1
    assert page.handlers == []


def test_nothing_is_fetched(data: bytes, tmp_path: Path) -> None:
    """The same file has the same page."""
    first = made(data, tmp_path)
    assert_harmless(Read(first))
    assert not re.search(rb"https?://|@import|url\(", first)
    assert made(data, tmp_path) == first


def test_the_scene_is_seen(data: bytes, tmp_path: Path) -> None:
    """Its picture is left out where a bound of the memory does not allow to draw it."""
    picture = b'alt="the scene in its default view"'
    assert picture in made(data, tmp_path)
    (tmp_path / "a.c3gs").write_bytes(data)
    words = ["inspect", str(tmp_path / "a.c3gs"), "--html", str(tmp_path / "b.html"), "--max-memory", "150M"]
    assert main(words) == 0
    assert picture not in (tmp_path / "b.html").read_bytes()


def test_the_bytes_are_those_of_the_json(data: bytes, tmp_path: Path) -> None:
    trained = EXAMPLE.parent / "valid" / "trained-caliterra.c3gs"
    for each in (data, EXAMPLE.read_bytes(), trained.read_bytes()):
        page = Read(made(each, tmp_path))
        facts = document(each, None)
        assert page.values["parts"] == [number for number in facts["parts"].values() if number]
        assert sum(page.values["parts"]) == len(each)
        sections = [length for inner, length in page.pieces if not inner]
        assert sections == [section["bytes"] for section in facts["sections"]]
        assert sum(sections) == len(each)
        # After its parts a section has at most its padding.
        inner = sum(length for inner, length in page.pieces if inner)
        split = sum(s["bytes"] for s in facts["sections"] if s["name"] in ("weights", "planes", "index", "data"))
        assert split - 4 * 3 < inner <= split


def test_the_bits_are_the_bytes_but_for_heads_and_states(data: bytes, tmp_path: Path) -> None:
    """SPEC 5.15 and 8.1: a lane's state takes 32 bits, of which 16 to 32 are not used by symbols."""
    page, facts = Read(made(data, tmp_path)), document(data, None)
    lanes = {name: 1 << facts["header"][f"{name}_lanes_log2"] for name in ("plane", "mask", "attribute")}
    chunks = facts["header"]["chunk_count"]
    kinds = [(5, lanes["plane"]), (chunks, lanes["mask"]), (chunks, lanes["attribute"])]
    if page.values["accounts"][3:] and facts["sections"][-2]["mode"]:
        kinds.insert(1, (chunks, lanes["mask"]))
    accounts = page.values["accounts"]
    assert len(accounts) == 2 * len(kinds)
    for coded, held, (streams, each) in zip(accounts[::2], accounts[1::2], kinds, strict=True):
        loss = coded / 1000
        assert streams * (8 + 2 * each) - loss <= held - coded <= streams * (8 + 4 * each + 1) + loss
    scene = parse(data).scene
    kept = 3 * int(scene.masks.sum())
    symbols = [6 * scene.anchor_count, kept, *(w * scene.anchor_count for w in scene.dimensions.slices)]
    assert all(f"{n:,}" in page.words["costs"] for n in [*symbols, scene.planes.size])
    # The attributes of all anchors are scalings, offsets and slices.
    assert sum(page.values["costs"][:-1]) / 8 == pytest.approx(accounts[-2], abs=0.01)


def test_what_a_file_says_is_no_markup(tmp_path: Path) -> None:
    scene = random_scene(4, 12)
    every = emit_metadata({"title": HOSTILE, "comment": "&amp; <b>", "x.y": "v" * 5000})
    known = (Ancillary(METADATA, 0, every, 0), cameras(3, HOSTILE), Ancillary(b"abCD", 0, b"<script>", 1))
    page = Read(made(emit(replace(scene, ancillary=known)), tmp_path, "<img src=x onerror=alert(3)>.c3gs"))
    assert_harmless(page)
    assert "alert('x')" in page.words[""]
    assert "&amp; <b>" in page.words[""]
    assert b"\x1b" not in (tmp_path / "page.html").read_bytes()
    assert "v" * 301 not in page.words[""]


def test_one_script_is_allowed(data: bytes, tmp_path: Path) -> None:
    page = made(data, tmp_path).decode()
    script = re.search(r"<script>(.*)</script>", page, re.DOTALL)
    assert script
    known = base64.b64encode(hashlib.sha256(script[1].encode()).digest()).decode()
    assert f"script-src 'sha256-{known}'\"" in page
    assert "default-src 'none'" in page


def test_a_large_scene_is_sampled_and_its_elements_are_cut(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measures, "SAMPLE_MAX", 70)
    monkeypatch.setattr(measures, "_ROWS", 33)
    monkeypatch.setattr(file_map, "ROWS_MAX", 50)
    scene = random_scene(4, 300, chunk_size=7)
    page = Read(made(emit(replace(scene, ancillary=(cameras(4),))), tmp_path))
    assert "Every 5th anchor is drawn, 60 of them." in page.words["anchors"]
    assert "The 43 chunks are drawn without their parts." in page.words["map"]
    assert "are left out" in page.words["bytes"]
    assert page.found["tr"] < 50 * 8 + 60
