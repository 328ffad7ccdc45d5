"""Encode and decode files."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Unpack, overload

from ..files.outputs import Kind
from ..files.stage import Stage, write_file
from ..files.text import counted, printable
from ..statuses import DONE, INTERRUPTED, UsageError, refusing
from . import kinds
from .command import ReadingWords, Report, command, only_one

if TYPE_CHECKING:
    from ..bitstream.bounds import Limits
    from ..bitstream.scene import Scene as CodedScene
    from .scenes import Scene

# The lines of a symbol trace (vectors/README.md).
TRACE = Kind("a symbol trace", re.compile(rb"(probe |planes|positions|masks|attributes|weights)\S*( -?\d+)+\n"))
Mode = Literal["raw", "packed"]


class EncodingWords(ReadingWords, total=False):
    """How a scene is encoded.

    Args:
        positions: raw: 48 bits per anchor; packed: about a tenth of that, with sorted anchors (default: packed in Main,
            or if the folder states it).
        weights: raw: 32 bits each; packed: integers for the coding networks (default: as for --positions).
        smallest: also try the scene without a hyperprior and with raw positions, and write the smallest file; no
            position, mask or attribute changes; for scenes of few anchors, such as those of fit.
        coarse_first: order the anchors in layers, those that cover most first: a part of the file, as it arrives or by
            ranges, shows the whole scene coarsely; scenes of few anchors grow by up to 2 %.
        lambda_r: lambda_r for an uncompressed scene: the steps grow with its square root (default: 0.004).
        steps: training steps of an uncompressed scene's model (default: 4000).
        up: up axis of the scene, such as --up=+z (default: that of the folder).
        cameras: write only the first N cameras of the folder, or none with 0; they reveal where photographs were taken,
            and export uses them (default: all; train keeps 16).
    """

    meta: Sequence[kinds.Meta] | Mapping[str, str]
    positions: Mode | None
    weights: Mode | None
    smallest: bool
    coarse_first: bool
    lambda_r: kinds.FitLambda | None
    steps: kinds.Positive | None
    up: kinds.Axis | None
    cameras: kinds.Count | None


@overload
def encode(scene: kinds.SceneFolder | Scene, output: None = None, **words: Unpack[EncodingWords]) -> bytes: ...
@overload
def encode(scene: kinds.SceneFolder | Scene, output: kinds.FilePath, **words: Unpack[EncodingWords]) -> Report: ...


@command("fit", requires=("output",), writes=True)
def encode(
    scene: kinds.SceneFolder | Scene, output: kinds.FilePath | None = None, **words: Unpack[EncodingWords]
) -> bytes | Report:
    """Encode a scene folder.

    A folder written by decode gives the same bytes again. For a Main file, add --positions raw if its positions
    are raw, and --weights raw if its weights are raw. If coded.safetensors is deleted,
    point_cloud.ply is quantised again. An uncompressed scene, of convert or of train --lambda 0, is quantised
    and gets an entropy model, as by fit. This takes minutes, and needs: pip install 'refcodec[fit]'.

    Args:
        scene: the scene folder.
        output: the C3GS file to write.

    Examples:
        encode scene -o scene.c3gs
        encode scene -o scene.c3gs --meta title=Kitchen --meta licence=CC-BY-4.0
        encode scene -o scene.c3gs --meta about.toml
        encode scene -o scene.c3gs --smallest
        encode converted -o scene.c3gs --lambda 0.01

    Returns:
        Without `output`, the bytes of the file. `scene` may be a refcodec.Scene. That of `decode` gives the same bytes.

    Raises ValueError if the scene violates a rule of SPEC.md, with the error of a decoder or the limits of the field,
    and TypeError for anything but a scene, and a field of `scene.coded` of a wrong type.
    """
    from ..bitstream.cameras import cameras, with_cameras
    from ..encoder.constants import smallest
    from ..encoder.layers import coarse_layers
    from ..encoder.positions import pack_positions
    from ..encoder.quantise import packed
    from ..folder.metadata import stated_entries, with_entries
    from ..folder.places import C3GS, check_outputs
    from .scenes import Scene
    from .shown import encoded

    given = scene if isinstance(scene, Scene) else None
    if given is None and not isinstance(scene, str | os.PathLike):
        raise TypeError(f"encode takes a refcodec.Scene, {type(scene).__name__} found; Scene(coded) makes one")
    name = "the scene" if given else os.fspath(scene)  # type: ignore[arg-type]
    check_outputs([None if given else name], (output, C3GS))
    entries = stated_entries(words.get("meta", ()))
    coded, stopped = (given.coded, "") if given else _folder_scene(Path(name), words)
    coded = with_entries(coded, entries)
    if (up := kinds.axis_number(words.get("up"))) is not None:
        coded = replace(coded, render=replace(coded.render, up_axis=up))
    if (count := words.get("cameras")) is not None:
        kept = cameras(coded.ancillary)[:count]
        coded = replace(coded, ancillary=with_cameras(coded.ancillary, kept))
    modes = words.get("positions"), words.get("weights")
    with refusing(f"{name} cannot be encoded"):
        if given is None or any(modes):
            coded = packed(coded, *modes)
        if words.get("smallest"):
            coded = smallest(coded, modes[0])
        if words.get("coarse_first"):
            if coded.position_model is None:
                raise UsageError("--coarse-first needs packed positions: add --positions packed")
            coded = pack_positions(coded, coarse_layers(coded))
    data = encoded(name, coded, words)
    if output is None:
        return data
    write_file(Path(output), data)
    values = {"bytes": len(data), "anchors": coded.anchor_count}
    line = f"{os.fspath(output)}: {len(data):,} bytes, {counted(coded.anchor_count, 'anchor')}"
    notes = [f"refcodec: {stopped}", line] if stopped else [line]
    return Report(values=values, notes=notes, status=INTERRUPTED if stopped else DONE)


def _folder_scene(folder: Path, words: EncodingWords) -> tuple[CodedScene, str]:
    """Returns the coded scene of a folder. An uncompressed one is fitted, with a message if that ended early."""
    from ..folder.layout import check_scene_folder
    from ..folder.places import check_cloud, limits_of, progress_bar
    from ..folder.read import read_folder
    from ..folder.uncompressed import is_uncompressed

    if limits_of(words).work is not None:
        raise UsageError("--max-work applies only to files, whose headers state the work: omit it")
    check_cloud(folder, words)
    if folder.is_file():
        raise UsageError(f"{folder} is a file: give a scene folder of decode, train, fit or convert")
    if is_uncompressed(folder):
        # This imports the training packages.
        from ..convert.fitted import fitted_scene

        with progress_bar(words) as show:
            return fitted_scene(folder, words.get("lambda_r"), words.get("steps"), show)
    if words.get("lambda_r") or words.get("steps"):
        raise UsageError(f"{folder} is coded already: omit --lambda and --steps, which are for uncompressed scenes")
    check_scene_folder(folder)
    return read_folder(folder), ""


class DecodingWords(ReadingWords, total=False):
    """What of a file is decoded.

    Args:
        splat: the .ply, .spz, .sog or .glb file to write, of a static scene; repeatable.
        chunks: read and write only chunks A to B - 1, counted from 0, and print their digests.
        keep_going: write the undamaged chunks of a damaged file and list the others on stderr; the exit status is still
            that of validate.
    """

    splat: Sequence[kinds.AnyPath] | kinds.AnyPath
    chunks: kinds.Chunks | None
    keep_going: bool


@overload
def decode(file: kinds.Place, *, limits: Limits | None = None) -> Scene: ...
@overload
def decode(file: kinds.Place, output: kinds.SceneFolder | None = None, **words: Unpack[DecodingWords]) -> Report: ...


@command("render", requires=("output", "splat"), writes=True)
def decode(
    file: kinds.Place, output: kinds.SceneFolder | None = None, **words: Unpack[DecodingWords]
) -> Scene | Report:
    """Decode a file into a scene folder, or a static scene into a splat file.

    SCENE_DIR is created. An existing folder must be empty or a scene folder. Its scene is replaced, and its
    other files stay.

    With --splat, the Gaussians of a static scene are written as they are: .ply and .glb lose nothing, .spz and
    .sog what the format loses. For other scenes, use export, which fits Gaussians to views.

    Args:

    Examples:
        decode scene.c3gs -o scene
        decode static.c3gs --splat scene.ply
        decode scene.c3gs -o part --chunks 2:5
        decode damaged.c3gs -o scene --keep-going

    Returns:
        Without `output` and `splat`, the scene. `file` may also be bytes or a file object.

    Raises BitstreamError for a rejected file, with the code, clause, requirement and offset of SPEC.md 10.3,
    BoundPassedError for one that exceeds the limits, and OSError for one that cannot be read.
    """
    from ..bitstream.reader import Reader
    from ..bitstream.streaming import check_numbers
    from ..folder.places import check_outputs, progress_bar, reading, shown_name
    from ..folder.write import decode_folder
    from .opening import open

    splat, chunks, keep_going = words.get("splat", ()), words.get("chunks"), words.get("keep_going", False)
    only_one(output=output, splat=splat)
    if splat:
        if chunks or keep_going:
            raise UsageError("--splat writes whole files only: omit --chunks and --keep-going")
        from .exporting import decode_splats

        return decode_splats(file, splat, words)
    if output is None:
        with open(file, limits=words.get("limits")) as opened:
            return opened.decode()
    if chunks and keep_going:
        raise UsageError("--chunks and --keep-going cannot be combined; list undamaged chunks only")
    name = shown_name(file)
    check_outputs([file], scene=output)
    with reading(file, words) as (source, left), progress_bar(words) as show:
        reader = Reader(source, keep_ancillary=chunks is None, limits=left)
        read = reader.open(critical_only=chunks is not None, progress=show)
        try:
            check_numbers(chunks, len(read.index))
        except IndexError as error:
            raise UsageError(f"{name}: {error}") from None
        written = decode_folder(read, os.fspath(output), chunks, keep_going=keep_going, progress=show)
    digests = {f"chunk {number}": text for number, text in zip(chunks or (), written.digests, strict=True)}
    notes = [] if written.error else [f"{os.fspath(output)}: {counted(written.anchors, 'anchor')} of {name}"]
    if keep_going:
        notes += written.losses(len(read.index))
    values = {"anchors": written.anchors, "damage": written.damage, **digests}
    lines = [f"{chunk} {text}" for chunk, text in digests.items()]
    return Report(lines, values, notes, written.error if keep_going else None)


@command()
def validate(file: kinds.Place, **words: Unpack[ReadingWords]) -> Report:
    """Check whether a file is a conforming bitstream.

    Examples:
        validate scene.c3gs

    Raises BitstreamError, BoundPassedError and OSError as `decode`.
    """
    from ..bitstream import ancillary
    from ..bitstream.limits import PROFILES
    from ..folder.places import decode_stream, reading, shown_name

    with reading(file, words) as (source, left):
        opened = decode_stream(source, left, words)
    header, warnings = opened.header, ancillary.warnings(opened.ancillary)
    profile = PROFILES[header.profile].name
    line = f"{shown_name(file)} is accepted: profile {profile}, {header.anchor_count} anchors"
    values = {"profile": profile, "anchors": header.anchor_count, "warnings": warnings}
    return Report([line], values, [f"warning: {printable(warning)}" for warning in warnings])


@command()
def digest(file: kinds.Place, *, parts: bool = False, **words: Unpack[ReadingWords]) -> str | dict[str, str]:
    """Print the SHA-256 of a file's reconstruction.

    Args:
        parts: one line for each part of the reconstruction, then the whole.

    Examples:
        digest scene.c3gs
        digest scene.c3gs --parts

    Returns:
        The digest (SPEC.md 9.3) in hexadecimal; with `parts` those of all parts by name, and of the whole.

    Raises BitstreamError, BoundPassedError and OSError as `decode`.
    """
    from ..bitstream.reconstruction import StreamDigest
    from ..folder.places import decode_stream, reading

    stream = StreamDigest()
    with reading(file, words) as (source, left):
        opened = decode_stream(source, left, words, stream.add)
    whole, each = stream.finish_parts(opened.scene([]))
    return {**each, "whole": whole} if parts else whole


@command(operands=("output",), writes=True)
def reconstruct(
    file: kinds.Place,
    output: kinds.AnyPath,
    *,
    trace: kinds.AnyPath | None = None,
    probes: bool = False,
    **words: Unpack[ReadingWords],
) -> None:
    """Write a file's canonical reconstruction (SPEC.md 9.3) after the bytes from which the digest is computed.

    Args:
        output: the file to write.
        trace: write a line with path and value to this file for every symbol.
        probes: with --trace: also write the numbers of each anchor, with the names of conformance/README.md.

    Examples:
        reconstruct scene.c3gs scene.bin
        reconstruct scene.c3gs scene.bin --trace symbols.txt --probes

    Raises BitstreamError, BoundPassedError and OSError as `decode`.
    """
    from ..bitstream.codec import parse
    from ..bitstream.reconstruction import DIGEST_MAGIC, LATER_MAGIC, digested, pieces
    from ..folder.places import COPIES, TRACE_COPIES, check_outputs, progress_bar, read_whole
    from ..inspect.trace import symbol_trace

    if probes and trace is None:
        raise UsageError("--probes needs --trace TRACE")
    check_outputs([file], (output, Kind.signed("a reconstruction", DIGEST_MAGIC, LATER_MAGIC)), (trace, TRACE))
    data = read_whole(file, words, COPIES if trace is None else COPIES + TRACE_COPIES)
    with Stage() as stage:
        if trace:
            lines = stage.open(Path(trace))
            scene = symbol_trace(data, lambda text: lines.write(text.encode()), probes=probes).scene
        else:
            with progress_bar(words) as show:
                scene = parse(data, progress=show).scene
        whole = stage.open(Path(output))
        whole.write(digested(scene))
        for _, piece in pieces(scene):
            whole.write(piece)


@command(requires=("output",), writes=True)
def migrate(file: kinds.AnyPath, output: kinds.AnyPath, **words: Unpack[ReadingWords]) -> Report:
    """Rewrite a file of version 0, the draft of the format, in the version of this program.

    The version and the CRC-32 of the prologue change, and nothing else. The file must have the last layout of version
    0. A file that has the version of this program already is copied. The new file is decoded before it is written. Its
    digest, which is printed, is the one that programs of version 0 print for the old file.

    Args:
        output: the C3GS file to write.

    Examples:
        migrate old.c3gs -o new.c3gs

    Raises BitstreamError, BoundPassedError and OSError as `decode`.
    """
    from ..bitstream.errors import BitstreamError
    from ..bitstream.header import MAJOR, PROLOGUE_BYTES, parse_prologue, restamped
    from ..folder.places import C3GS, check_outputs, read_whole

    check_outputs([file], (output, C3GS))
    data, done = read_whole(file, words), "has this version already, and is copied"
    try:
        parse_prologue(data[:PROLOGUE_BYTES])
    except BitstreamError as error:
        if (error.kind.name, error.found) != ("prologue.version", "0"):
            raise
        data, done = restamped(data), "was of version 0"
    whole = digest(data, **words)
    assert isinstance(whole, str)
    write_file(Path(output), data)
    lines = [f"{os.fspath(output)}: version {MAJOR}, digest {whole}; {os.fspath(file)} {done}"]
    return Report(lines, {"bytes": len(data), "version": MAJOR, "digest": whole})
