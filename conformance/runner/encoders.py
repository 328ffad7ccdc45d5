"""Judges the files of another encoder: valid, canonical, as meant, and with the same result from both decoders."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass

from refcodec.bitstream import ancillary, codec
from refcodec.bitstream.errors import BitstreamError
from refcodec.bitstream.reconstruction import digest
from refcodec.files.text import printable
from refcodec.inspect import dump

from .. import spec_decoder
from ..spec_decoder.watch import watched
from . import divergence, probes


@dataclass(frozen=True)
class Meant:
    """What the encoder says of a file: the digest of its scene, its reconstruction (9.3), its probes. None: nothing."""

    digest: str | None = None
    reconstruction: bytes | None = None
    probes: bytes | None = None


@dataclass(frozen=True)
class Verdict:
    """good: whether the file is right. text: the reason. lines: warnings, or the bytes at the fault, annotated."""

    good: bool
    text: str
    lines: tuple[str, ...] = ()


def examine(data: bytes, meant: Meant = Meant()) -> Verdict:
    """Returns the verdict on a file."""
    first: tuple[int, int] | str
    error: BitstreamError | None = None
    try:
        scene = codec.parse(data).scene
        first = digest(scene)[0]
    except BitstreamError as found:
        error, first = found, (found.kind.code, found.offset)
    second: tuple[int, int] | str
    try:
        second = spec_decoder.decode(data).digest
    except spec_decoder.C3GSError as found:
        second = (found.code, found.offset)
    if first != second:
        return Verdict(
            False,
            f"the decoders differ, please report the file: {first} from refcodec, {second} from the second decoder",
        )
    if error:
        kind = error.kind
        told = () if meant.probes is None else tuple(_of_refused(data, meant.probes))
        near = tuple(dump.hex_lines(data, [error], error.offset))
        return Verdict(
            False,
            f"{kind.klass}: {kind.code} {kind.name} at byte {error.offset}, clause {kind.clause}: {error}",
            (*told, *near),
        )
    again = codec.emit(scene)
    if again != data:
        at = next((i for i, (a, b) in enumerate(zip(data, again, strict=False)) if a != b), min(len(data), len(again)))
        return Verdict(
            False,
            f"not canonical (4.3): refcodec writes other bytes from byte {at} on",
            tuple(dump.hex_lines(data, near=at)),
        )
    warnings = tuple(f"warning: {printable(warning)}" for warning in ancillary.warnings(scene.ancillary))
    differs = list(_differences(data, meant))
    if differs or (meant.digest or first) != first:
        text = f"valid, but not the scene that was meant: its digest is {first}"
        return Verdict(False, text + (f", not {meant.digest}" if meant.digest else ""), (*differs, *warnings))
    return Verdict(True, f"valid, canonical, the same result from both decoders; digest {first}", warnings)


def _differences(data: bytes, meant: Meant) -> Iterator[str]:
    """Yields the first differences of a valid file from what the encoder meant."""
    if meant.probes is not None:
        symbol, compared = divergence.of_trace(data, meant.probes)
        yield from _probes(compared)
        if symbol:
            yield _difference(symbol)
    if meant.reconstruction is not None:
        value = divergence.of_output(data, meant.reconstruction)
        if value:
            yield _difference(value)


def _difference(found: divergence.Divergence) -> str:
    """Returns a difference as a line: the file is right, and the encoder meant another value."""
    values = f"{found.expected} in the file, {found.found} was meant ({found.differing})"
    return f"{found.part}: {found.element} is {values}; read {found.clauses}"


def _probes(compared: probes.Compared) -> Iterator[str]:
    if compared.first:
        p = compared.first
        what = f"the first number that differs is {p.name}[{p.index}] of anchor {p.anchor}"
        yield f"{what}: {p.wanted} in the decoders, {p.found} in the encoder (SPEC {', '.join(p.clauses)})"
    if compared.fault:
        yield f"probe: {compared.fault}"


def _of_refused(data: bytes, trace: bytes) -> Iterator[str]:
    """Yields the first difference of an encoder's probes from the numbers of the decoders, which refuse the file."""
    try:
        header = codec.parse_container(data)
    except BitstreamError:
        return
    file = io.StringIO()
    with watched(file, probed=True), suppress(spec_decoder.C3GSError):
        spec_decoder.decode(data)
    right = probes.OfTrace(file.getvalue().encode(), header.anchor_count, header.section(b"INDX").mode == 1)
    compared = probes.compare(right, trace, None)
    yield from _probes(compared)
    if compared.first and compared.first.name.startswith("slice."):
        yield "it depends on decoded symbols, which may be wrong themselves"
