"""The promises between minor versions (SPEC.md 12.3), acted out with three mock versions 0.1.

A mock version is the blocks of SPEC.md with some changes. Its decoder reads files of its own, the decoders of version 0
answer these as 12.2 and 12.3 say, and files of version 0 keep their verdicts and digests.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
from decoders import Decoders
from random_scenes import random_scene

from conformance import spec_decoder
from conformance.cases.target import Target
from conformance.fuzz.compare import Verdict, first_verdict
from conformance.manifest import Accepted, Rejected, Vector, load
from conformance.mutants.mutant import text
from refcodec.bitstream import codec, directory
from refcodec.bitstream.scene import Ancillary
from refcodec.bitstream.source import pad4

Decoder = Callable[[bytes], Verdict]
SCENE = random_scene(12, 9, chunk_size=4)
ACCEPTED = first_verdict(codec.emit(SCENE))
SUITE = load()
# The second decoder takes 12 s for the one larger file of the sample.
LARGEST = 50_000
SAMPLE = [v for v in SUITE.vectors[::20] if v.operation == "decode" and v.input.size <= LARGEST]

# --- the versions: a text of the blocks, and what stands before it or in its place in version 0.1 ---------------------

# A u32 behind the directory, which is at most 100.
FIELD = {
    '    extra = reader["end"]': """\
    if minor >= 1:
        TAKE(reader, "exposure", 4, 1, False)
    extra = reader["end"]""",
    '    REQUIRE(work <= level["work"]': """\
    if "exposure" in v:
        REQUIRE(v["exposure"][0] <= 100, "header.exposure", at["exposure"])
    REQUIRE(work <= level["work"]""",
}
# Mode 2 of WGTS: mode 0 with all values negated.
MODE = {
    "        most = 1 if": """\
        most = 2 if e["type"] == WGTS else 1 if""",
    'if e["type"] == WGTS and e["mode"] == 0:': """\
if e["type"] == WGTS and e["mode"] in (0, 2):""",
    '            s["weights"] = PARSE_WEIGHTS(': """\
            if e["mode"] == 2:
                first = at + PAD4(2 + sum(v["slice_width"][:-1]))
                negated = [b ^ 128 if i % 4 == 3 else b for i, b in enumerate(data[first:end])]
                data = data[:first] + negated + data[end:]
                e["mode"] = 0
            s["weights"] = PARSE_WEIGHTS(""",
}
# A critical section HASH, which may follow DATA: the digest of the scene.
SECTION = {
    '"INDX", "DATA")]': """\
"INDX", "DATA", "HASH")]""",
    "FRAM, WGTS, PLNS, INDX, DATA =": """\
FRAM, WGTS, PLNS, INDX, DATA, HASH =""",
    "(t != PLNS or ch)]": """\
(t != PLNS or ch) and (t != HASH or HASH in [e["type"] for e in entries])]""",
    '        if e["type"] == INDX:\n            right': """\
        if e["type"] == HASH:
            right = e["length"] == 32
        if e["type"] == INDX:
            right""",
    '        if e["type"] == FRAM:\n            s[': """\
        if e["type"] == HASH:
            s["hash"] = at
        if e["type"] == FRAM:
            s[""",
    '    return {"parts": digests': """\
    if "hash" in s:
        scene = SHA256(head + [byte for own in digests for byte in own])
        REQUIRE(data[s["hash"] : s["hash"] + 32] == scene, "hash.digest", s["hash"])
    return {"parts": digests""",
}


def decoder(changes: dict[str, str], minor: int = 1) -> Decoder:
    """Returns the decoder of a version, whose verdicts are those of first_verdict. changes: new text by old text."""
    source = text()
    for old, new in {"\nMINOR = 0\n": f"\nMINOR = {minor}\n", **changes}.items():
        assert source.count(old) == 1, old
        source = source.replace(old, new)
    names = spec_decoder.names(compile(source, "version", "exec", dont_inherit=True))

    def decode(data: bytes) -> Verdict:
        found, error = spec_decoder.verdict(names, data)
        return error or (bytes(found["scene"]).hex() if found else "", -1)

    return decode


DECODERS = {"field": decoder(FIELD), "mode": decoder(MODE), "section": decoder(SECTION)}


# --- their files ------------------------------------------------------------------------------------------------------


def with_field(value: int) -> bytes:
    return codec.emit(replace(SCENE, minor=1, later=value.to_bytes(4, "little")))


def with_mode(minor: int = 1) -> tuple[bytes, int]:
    """Returns the scene with weights in mode 2, and the offset of the mode."""
    t = Target(codec.emit(replace(SCENE, minor=minor)))
    section, content = t.section(directory.WEIGHTS), t.content(directory.WEIGHTS)
    first = pad4(2 + sum(SCENE.dimensions.slices[:-1]))
    values = bytes(b ^ 128 if i % 4 == 3 else b for i, b in enumerate(content[first:]))
    mode = f"directory[{section.number}].mode"
    return Target(t.put(section.start + first, values)).with_values({mode: 2}), t.at(mode)


def with_section(digest: str, minor: int = 1) -> tuple[bytes, int, int]:
    """Returns the scene with a section HASH, the offset of its entry, and that of its content."""
    ancillary = (Ancillary(b"hASH", 0, bytes.fromhex(digest), 5),)
    t = Target(codec.emit(replace(SCENE, minor=minor, ancillary=ancillary)))
    section = t.section(b"hASH")
    kind = f"directory[{section.number}].type"
    return t.with_values({kind: b"HASH"}), t.at(kind), section.start


# --- the promises -----------------------------------------------------------------------------------------------------


def test_a_later_version_decodes_its_files() -> None:
    """Whatever their minor version is: a decoder does not check that it is the lowest."""
    assert DECODERS["field"](with_field(100)) == ACCEPTED
    assert DECODERS["field"](with_field(101))[0] == "header.exposure"
    for minor in (0, 1):
        assert DECODERS["mode"](with_mode(minor)[0]) == ACCEPTED
        assert DECODERS["section"](with_section(ACCEPTED[0], minor)[0]) == ACCEPTED
    wrong, _, content = with_section("00" * 32)
    assert DECODERS["section"](wrong) == ("hash.digest", content)


@pytest.mark.requirement("R6.2-3")
def test_version_0_ignores_a_later_field(decoders: Decoders) -> None:
    """Also one with a value that version 0.1 refuses."""
    assert decoders.agreed(with_field(100)) == decoders.agreed(with_field(101)) == ACCEPTED


@pytest.mark.requirement("R6.6-4")
def test_version_0_does_not_support_a_later_mode(decoders: Decoders) -> None:
    data, at = with_mode()
    assert decoders.agreed(data) == ("directory.mode", at)


@pytest.mark.requirement("R6.6-2")
def test_version_0_does_not_support_a_later_section(decoders: Decoders) -> None:
    data, at, _ = with_section(ACCEPTED[0])
    assert decoders.agreed(data) == ("directory.unknown_critical", at)


def _expected(vector: Vector) -> Verdict:
    if isinstance(vector.expectation, Rejected):
        return vector.expectation.name, vector.expectation.offset
    assert isinstance(vector.expectation, Accepted)
    return vector.expectation.digest, -1


@pytest.mark.parametrize("version", DECODERS)
def test_a_later_version_keeps_the_verdicts_of_version_0(version: str) -> None:
    """None of these files has the element that the version adds."""
    files = [(vector, SUITE.path(vector).read_bytes()) for vector in SAMPLE]
    kept = [(vector, data) for vector, data in files if data[10:12] in (b"\0\0", b"")]
    assert {vector.klass for vector, _ in kept} == {"valid", "malformed", "invalid", "unsupported", "resource"}
    for vector, data in kept:
        assert DECODERS[version](data) == _expected(vector), vector.id
