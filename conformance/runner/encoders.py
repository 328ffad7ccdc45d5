"""Judges the files of another encoder: valid, canonical, and with the same result from both decoders."""

from __future__ import annotations

from dataclasses import dataclass

from refcodec.bitstream import codec
from refcodec.bitstream.errors import BitstreamError
from refcodec.bitstream.reconstruction import digest
from refcodec.inspect import dump

from .. import spec_decoder


@dataclass(frozen=True)
class Verdict:
    """good: whether the file is right. text: the reason. lines: the bytes at the fault, annotated."""

    good: bool
    text: str
    lines: tuple[str, ...] = ()


def examine(data: bytes) -> Verdict:
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
        near = tuple(dump.hex_lines(data, [error], error.offset))
        return Verdict(
            False, f"{kind.klass}: {kind.code} {kind.name} at byte {error.offset}, clause {kind.clause}: {error}", near
        )
    again = codec.emit(scene)
    if again != data:
        at = next((i for i, (a, b) in enumerate(zip(data, again, strict=False)) if a != b), min(len(data), len(again)))
        return Verdict(
            False,
            f"not canonical (4.3): refcodec writes other bytes from byte {at} on",
            tuple(dump.hex_lines(data, near=at)),
        )
    return Verdict(True, f"valid, canonical, the same result from both decoders; digest {first}")
