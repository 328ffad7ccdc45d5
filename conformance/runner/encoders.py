"""Judges the files of another encoder: valid, canonical, as meant, and with the same result from both decoders."""

from dataclasses import dataclass

from refcodec.bitstream import ancillary, codec
from refcodec.bitstream.errors import BitstreamError
from refcodec.bitstream.reconstruction import digest
from refcodec.files.text import printable
from refcodec.inspect import dump

from .. import spec_decoder
from . import divergence


@dataclass(frozen=True)
class Meant:
    """What the encoder says of a file: the digest of its scene, and its reconstruction (9.3). None: nothing."""

    digest: str | None = None
    reconstruction: bytes | None = None


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
        text = f"the decoders differ, please report the file: {first} from refcodec, {second} from the second decoder"
        return Verdict(False, text)
    if error:
        kind = error.kind
        text = f"{kind.klass}: {kind.code} {kind.name} at byte {error.offset}, clause {kind.clause}: {error}"
        return Verdict(False, text, tuple(dump.hex_lines(data, [error], error.offset)))
    again = codec.emit(scene)
    if again != data:
        at = next((i for i, (a, b) in enumerate(zip(data, again, strict=False)) if a != b), min(len(data), len(again)))
        text = f"not canonical (4.3): refcodec writes other bytes from byte {at} on"
        return Verdict(False, text, tuple(dump.hex_lines(data, near=at)))
    warnings = tuple(f"warning: {printable(warning)}" for warning in ancillary.warnings(scene.ancillary))
    differs = None if meant.reconstruction is None else divergence.of_output(data, meant.reconstruction)
    if differs or (meant.digest or first) != first:
        text = f"valid, but not the scene that was meant: its digest is {first}"
        lines = (_difference(differs),) if differs else ()
        return Verdict(False, text + (f", not {meant.digest}" if meant.digest else ""), (*lines, *warnings))
    return Verdict(True, f"valid, canonical, the same result from both decoders; digest {first}", warnings)


def _difference(first: divergence.Divergence) -> str:
    """Returns a difference as a line: the file is right, and the encoder meant another value."""
    values = f"{first.expected} in the file, {first.found} was meant ({first.differing})"
    return f"{first.part}: {first.element} is {values}; read {first.clauses}"
