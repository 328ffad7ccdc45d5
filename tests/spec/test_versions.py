"""The promises between minor versions (SPEC.md 12.3), acted out with a mock version 0.1 for each kind of addition.

A mock version is the blocks of SPEC.md with some changes. Its decoder reads files of minor version 1 that have the
addition. The decoders of this version answer these as 12.1 to 12.3 say. Files of minor version 0 keep their verdicts.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import pytest
from random_scenes import random_scene

from conformance import spec_decoder
from conformance.cases.target import Target
from conformance.fuzz.compare import Verdict, first_verdict
from conformance.manifest import Accepted, Rejected, load
from conformance.spec_decoder.program import SPEC, source
from refcodec.bitstream import codec
from refcodec.bitstream.cameras import CAMERAS, NamedCamera, emit_cameras
from refcodec.bitstream.dimensions import Dimensions
from refcodec.bitstream.metadata import with_metadata
from refcodec.bitstream.scene import Ancillary

# Without planes and CARM, which take the blocks most of their time.
SCENE = random_scene(12, 5, Dimensions(2, (5,), 0, 2, 0, (6,), (), (), 3), chunk_size=4)
SCENE = replace(SCENE, ancillary=())
SUITE = load()
SAMPLE = [v for v in SUITE.vectors[::9] if v.operation == "decode" and v.input.size < 5000]
# The directory's checks know the minor version.
COMMON = {
    "\nMINOR = 0\n": "\nMINOR = 1\n",
    '    return {"value": value,': '    return {"minor": minor, "value": value,',
}
IGNORED = "ignored"


def edited(values: dict[str, object], minor: int = 1, name: str = "") -> bytes:
    """A file with other values of elements. name: of a valid vector, empty for the scene."""
    data = (SUITE.folder / "valid" / f"{name}.c3gs").read_bytes() if name else codec.emit(SCENE)
    return Target(data).with_values({"prologue.minor": minor, **values})


def with_section(kind: bytes, minor: int = 1, mode: int = 0, content: bytes = b"\5\0\0\0") -> bytes:
    """A file with a section after all others."""
    section = Ancillary(kind, mode, content, 4)
    return codec.emit(replace(SCENE, minor=minor, ancillary=(section,)))


def critical(kind: bytes, minor: int = 1) -> bytes:
    t = Target(with_section(kind.lower()[:1] + kind[1:], minor))
    return t.with_values({f"directory[{len(t.header.sections) - 1}].type": kind})


def with_field(minor: int = 1) -> bytes:
    return codec.emit(replace(SCENE, minor=minor, later=b"\x64\0\0\0" if minor else b""))


def with_camera(minor: int = 1) -> bytes:
    """A file whose camera has four more bytes."""
    content = bytearray(emit_cameras([NamedCamera("name")]))
    content[4:8] = (int.from_bytes(content[4:8], "little") + 4).to_bytes(4, "little")
    return with_section(CAMERAS, minor, content=bytes(content) + b"\1\2\3\4")


@dataclass(frozen=True)
class Mock:
    """A mock version.

    changes: of the blocks, the new text by the old one. file: with the addition, of a minor version. old: the error of
    decoders of version 0, or IGNORED. later: that of the mock version, if it refuses the file.
    """

    changes: dict[str, str]
    file: Callable[[int], bytes]
    old: str = IGNORED
    later: str = ""


MODE = 'most = 1 if e["type"] in (WGTS, INDX) else 0'
MOCKS = {
    "a critical section type": Mock(
        {
            'in CRITICAL, "directory.unknown': 'in CRITICAL + LATER * h["minor"], "directory.unknown',
            "FRAM, WGTS, PLNS, INDX, DATA = CRITICAL\n": "FRAM, WGTS, PLNS, INDX, DATA = CRITICAL\n"
            'LATER = [ASCII("NEWS")]\n',
            'if not e["type"][0] & 32:': 'if not e["type"][0] & 32 and e["type"] not in LATER:',
        },
        lambda minor: critical(b"NEWS", minor),
        "directory.unknown_critical",
    ),
    "an ancillary section type": Mock({}, lambda minor: with_section(b"nEWS", minor)),
    "a meaning of the third letter": Mock({}, lambda minor: with_section(b"nEwS", minor)),
    "a mode of an ancillary section": Mock({}, lambda minor: with_section(CAMERAS, minor, 77)),
    "a mode": Mock(
        {MODE: f'{MODE}\n        most = 9 if e["type"] == DATA and h["minor"] else most'},
        lambda minor: edited({"directory[3].mode": 9}, minor),
        "directory.mode",
    ),
    "a profile": Mock(
        {
            "    REQUIRE(profile < len(BOUNDS)": "    profile = 0 if h['minor'] and profile == 2 else profile\n"
            "    REQUIRE(profile < len(BOUNDS)"
        },
        lambda minor: edited({"profile": 2, "level": 0}, minor),
        "header.profile",
    ),
    "a level": Mock(
        {
            "    REQUIRE(len(chosen) == 1": "    if h['minor'] and v['level'][0] == 5:\n"
            "        chosen = [{'profile': 0, 'level': 0, 'anchor_count': 99999, 'plane_size': 99, 'work': 1 << 40}]\n"
            "    REQUIRE(len(chosen) == 1"
        },
        lambda minor: edited({"level": 5}, minor),
        "header.level",
    ),
    "a render model with a part": Mock(
        {
            '    return {"parts": digests,': '    if minor and v["render_model"][0] == 2:\n'
            '        found = digests + [SHA256(parts["weights"])]\n'
            '        return {"parts": found, "scene": SHA256(head + sum(digests, [])), "chunks": []}\n'
            '    return {"parts": digests,'
        },
        lambda minor: edited({}, minor, "render-model-2"),
    ),
    "a meaning of a reserved field": Mock(
        {
            '        REQUIRE(value[name][0] == 0, "header.reserved"': '        may = minor and "grid" not in name\n'
            '        REQUIRE(value[name][0] == 0 or may, "header.reserved"'
        },
        lambda minor: edited({"render_info.reserved": 3}, minor),
        "header.reserved",
    ),
    "a field of the header": Mock(
        {
            '    extra = reader["end"]': '    if minor >= 1:\n        TAKE(reader, "exposure", 4, 1, False)\n'
            '    extra = reader["end"]'
        },
        with_field,
    ),
    "a code of an error": Mock(
        {
            '    extra = reader["end"]': '    if minor >= 1:\n        TAKE(reader, "exposure", 4, 1, False)\n'
            '        REQUIRE(value["exposure"][0] < 100, "header.exposure", reader["at"])\n    extra = reader["end"]'
        },
        with_field,
        later="header.exposure",
    ),
    "a field of a camera": Mock({}, with_camera),
    "a key of metadata": Mock(
        {}, lambda minor: codec.emit(replace(SCENE, minor=minor, ancillary=with_metadata((), {"mood": "calm"})))
    ),
}


@cache
def blocks(name: str) -> spec_decoder.Names:
    """The names of a mock version."""
    text = source(SPEC.read_text(encoding="utf-8"))
    for old, new in {**COMMON, **MOCKS[name].changes}.items():
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return spec_decoder.names(compile(text, name, "exec", dont_inherit=True))


def verdict_of(names: spec_decoder.Names, data: bytes) -> Verdict:
    found, error = spec_decoder.verdict(names, data)
    return error or (bytes(found["scene"]).hex() if found else "", -1)


@pytest.mark.parametrize("name", MOCKS)
def test_a_later_version_and_this_one(name: str) -> None:
    mock = MOCKS[name]
    data, before = mock.file(1), verdict_of(spec_decoder.names(), mock.file(1))
    assert first_verdict(data) == before
    assert (before[0] if before[1] >= 0 else IGNORED) == mock.old
    later = verdict_of(blocks(name), data)
    assert later[0] == mock.later if mock.later else later[1] == -1
    if mock.old == IGNORED and not mock.later:
        # What this version skips changes no digest that it reports.
        assert later == before
    # The addition counts only in files of its minor version.
    assert verdict_of(blocks(name), mock.file(0)) == first_verdict(mock.file(0))


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name, mock in MOCKS.items() if mock.changes])
def test_a_later_version_keeps_the_verdicts_of_this_one(name: str) -> None:
    for v in SAMPLE:
        data, expected = SUITE.path(v).read_bytes(), v.expectation
        if data[10:12] not in (b"\0\0", b""):
            continue
        if isinstance(expected, Rejected):
            assert verdict_of(blocks(name), data) == (expected.name, expected.offset), v.id
        elif isinstance(expected, Accepted):
            assert verdict_of(blocks(name), data)[0] == expected.digest, v.id
