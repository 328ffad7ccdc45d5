"""The commands that encode and decode: encode, decode, validate, digest, reconstruct."""

# Modules that need NumPy are imported where they are used, so that help is instant.
# ruff: noqa: PLC0415

from __future__ import annotations

import argparse
import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..files.outputs import Kind, check_apart, check_file
from ..files.stage import Stage, write_file
from ..files.terminal import note, say
from ..files.text import printable
from . import train_options
from .bounds import add_bounds, check_folder, open_bounded, read_bounded, reader_bounds
from .meta import add_meta, metadata_of, with_entries
from .shared import (
    FILE,
    UsageError,
    add_command,
    check_scene_folder,
    check_scene_output,
    counted,
    decoded,
    encoded,
    fit_rate,
    parse_file,
    positive,
    progress_bar,
    reject,
    whole,
)

if TYPE_CHECKING:
    from ..folder.write import Written

# The lines of a symbol trace (vectors/README.md).
TRACE = Kind("a symbol trace", re.compile(rb"(probe |planes|positions|masks|attributes|weights)\S*( -?\d+)+\n"))


def _encode(arguments: argparse.Namespace) -> int:
    from ..bitstream.cameras import cameras, with_cameras
    from ..bitstream.header import SIGNATURE
    from ..folder.read import read_folder
    from ..folder.uncompressed import is_uncompressed

    output = Path(arguments.output)
    check_file(output, Kind.signed("a C3GS file", SIGNATURE))
    check_apart([output], [arguments.scene])
    check_folder(arguments, Path(arguments.scene))
    entries = metadata_of(arguments)
    if Path(arguments.scene).is_file():
        raise UsageError(f"{arguments.scene} is a file: give a scene folder of decode, train, fit or convert")
    status = 0
    if is_uncompressed(Path(arguments.scene)):
        # This imports the training packages.
        from .converting import fitted

        scene, status = fitted(arguments)
    elif arguments.lambda_r or arguments.steps:
        raise UsageError(
            f"{arguments.scene} is coded already: omit --lambda and --steps, which are for uncompressed scenes"
        )
    else:
        check_scene_folder(Path(arguments.scene))
        scene = read_folder(arguments.scene)
    scene = with_entries(scene, entries)
    up = train_options.up_axis(arguments)
    if up is not None:
        scene = replace(scene, render=replace(scene.render, up_axis=up))
    if arguments.cameras is not None:
        stated = cameras(scene.ancillary)[: arguments.cameras]
        scene = replace(scene, ancillary=with_cameras(scene.ancillary, stated))
    data = encoded(arguments, arguments.scene, scene, arguments.positions, arguments.weights, arguments.smallest)
    write_file(output, data)
    note(f"{output}: {len(data):,} bytes, {counted(scene.anchor_count, 'anchor')}")
    return status


def _decode(arguments: argparse.Namespace) -> int:
    from ..bitstream.reader import Reader
    from ..bitstream.streaming import check_numbers
    from ..folder.write import decode_folder

    if arguments.splat:
        if arguments.chunks or arguments.keep_going:
            raise UsageError("--splat writes whole files only: omit --chunks and --keep-going")
        from .exporting import decode_splats

        return decode_splats(arguments)
    check_scene_output(Path(arguments.output), [arguments.file])
    numbers = arguments.chunks
    if numbers and arguments.keep_going:
        raise UsageError("--chunks and --keep-going cannot be combined; list undamaged chunks only")
    with open_bounded(arguments) as source, progress_bar(arguments.progress) as progress:
        reader = Reader(source, keep_ancillary=numbers is None, bounds=reader_bounds(arguments))
        opened = reader.open(critical_only=numbers is not None, progress=progress)
        try:
            check_numbers(numbers, len(opened.index))
        except IndexError as error:
            raise UsageError(f"{arguments.file}: {error}") from None
        written = decode_folder(opened, arguments.output, numbers, keep_going=arguments.keep_going, progress=progress)
    for number, digest in zip(numbers or (), written.digests, strict=True):
        print(f"chunk {number} {digest}")
    if not written.error:
        note(f"{arguments.output}: {counted(written.anchors, 'anchor')} of {arguments.file}")
    return _report_damage(arguments.file, len(opened.index), written) if arguments.keep_going else 0


def _report_damage(path: str, chunks: int, written: Written) -> int:
    """Reports each dropped chunk on stderr, and then the same verdict on the file as validate."""
    if written.damage:
        for number, error in sorted(written.damage.items()):
            note(f"chunk {number} with {counted(written.lost[number], 'anchor')} is dropped: {error}")
        lost = counted(sum(written.lost.values()), "anchor")
        note(f"{len(written.damage)} of {chunks} chunks and {lost} are lost, and {written.anchors:,} are written")
    elif written.error:
        note("no chunk is damaged, but another part of the file is")
    return reject(path, written.error) if written.error else 0


def _validate(arguments: argparse.Namespace) -> int:
    from ..bitstream import ancillary
    from ..bitstream.limits import PROFILES

    with open_bounded(arguments) as source:
        opened = decoded(arguments, source, reader_bounds(arguments))
    for warning in ancillary.warnings(opened.ancillary):
        note(f"warning: {printable(warning)}")
    h = opened.header
    say(f"{arguments.file} is accepted: profile {PROFILES[h.profile].name}, {h.anchor_count} anchors")
    return 0


def _digest(arguments: argparse.Namespace) -> int:
    from ..bitstream.reconstruction import StreamDigest

    digest = StreamDigest()
    with open_bounded(arguments) as source:
        opened = decoded(arguments, source, reader_bounds(arguments), digest.add)
    whole, parts = digest.finish_parts(opened.scene([]))
    if arguments.parts:
        for name, value in {**parts, "whole": whole}.items():
            print(f"{name:<10} {value}")
    else:
        print(whole)
    return 0


def _reconstruct(arguments: argparse.Namespace) -> int:
    from ..bitstream.reconstruction import DIGEST_MAGIC, canonical_parts, digested

    output = Path(arguments.output)
    trace = Path(arguments.trace) if arguments.trace else None
    if arguments.probes and trace is None:
        raise UsageError("--probes needs --trace TRACE")
    check_file(output, Kind.signed("a reconstruction", DIGEST_MAGIC))
    if trace:
        check_file(trace, TRACE)
    check_apart([output, *([trace] if trace else [])], [arguments.file])
    data = read_bounded(arguments)
    with Stage() as stage:
        if trace:
            from ..inspect.trace import symbol_trace

            lines = stage.open(trace)
            scene = symbol_trace(data, lambda text: lines.write(text.encode()), probes=arguments.probes).scene
        else:
            scene = parse_file(arguments, data).scene
        whole = stage.open(output)
        parts = list(canonical_parts(scene))
        whole.write(digested(scene, parts))
        for _, part in parts:
            whole.write(part)
    return 0


def _chunks(text: str) -> range:
    """Returns the chunk numbers of A:B."""
    match = re.fullmatch(r"([0-9]{1,9}):([0-9]{1,9})", text)
    if match is None or int(match[1]) >= int(match[2]):
        raise argparse.ArgumentTypeError(f"must be A:B with A below B, not {text}")
    return range(int(match[1]), int(match[2]))


def add(commands: Any) -> None:
    """Adds the commands of this module."""
    encode = add_command(
        commands,
        "encode",
        _encode,
        "encode a scene folder",
        [
            "encode scene -o scene.c3gs",
            "encode scene -o scene.c3gs --meta title=Kitchen --meta licence=CC-BY-4.0",
            "encode scene -o scene.c3gs --meta about.toml",
            "encode scene -o scene.c3gs --smallest",
            "encode converted -o scene.c3gs --lambda 0.01",
        ],
        "A folder written by decode gives the same bytes again. For a Main file, add --positions raw if its positions\n"
        "are raw, and --weights raw if its weights are raw. If coded.safetensors is deleted,\n"
        "point_cloud.ply is quantised again. An uncompressed scene, of convert or of train --lambda 0, is quantised\n"
        "and gets an entropy model, as by fit. This takes minutes, and needs: pip install 'refcodec[fit]'.",
        writes=True,
    )
    encode.add_argument("scene", metavar="SCENE_DIR", help="the scene folder")
    add_bounds(encode, decodes=False)
    encode.add_argument("-o", "--output", metavar="FILE", required=True, help="the C3GS file to write")
    add_meta(encode)
    encode.add_argument(
        "--positions",
        choices=("raw", "packed"),
        help="raw: 48 bits per anchor; packed: about a tenth of that, with sorted anchors (default: packed in Main, "
        "or if the folder states it)",
    )
    encode.add_argument(
        "--weights",
        choices=("raw", "packed"),
        help="raw: 32 bits each; packed: integers for the coding networks (default: as for --positions)",
    )
    encode.add_argument(
        "--smallest",
        action="store_true",
        help="also try the scene without a hyperprior and with raw positions, and write the smallest file; no "
        "position, mask or attribute changes; for scenes of few anchors, such as those of fit",
    )
    encode.add_argument(
        "--lambda",
        dest="lambda_r",
        type=fit_rate,
        metavar="L",
        help="lambda_r for an uncompressed scene: the steps grow with its square root (default: 0.004)",
    )
    encode.add_argument(
        "--steps", type=positive, metavar="N", help="training steps of an uncompressed scene's model (default: 4000)"
    )
    train_options.add_up(encode, "that of the folder")
    encode.add_argument(
        "--cameras",
        type=whole,
        metavar="N",
        help="write only the first N cameras of the folder, or none with 0; they reveal where photographs were taken, "
        "and export uses them (default: all; train keeps 16)",
    )
    decode = add_command(
        commands,
        "decode",
        _decode,
        "decode a file into a scene folder, or a static scene into a splat file",
        [
            "decode scene.c3gs -o scene",
            "decode static.c3gs --splat scene.ply",
            "decode scene.c3gs -o part --chunks 2:5",
            "decode damaged.c3gs -o scene --keep-going",
        ],
        "SCENE_DIR is created. An existing folder must be empty or a scene folder. Its scene is replaced, and its\n"
        "other files stay.\n\n"
        "With --splat, the Gaussians of a static scene are written as they are: .ply and .glb lose nothing, .spz and\n"
        ".sog what the format loses. For other scenes, use export, which fits Gaussians to views.",
        writes=True,
    )
    decode.add_argument("file", metavar="FILE", help=FILE)
    add_bounds(decode)
    results = decode.add_mutually_exclusive_group(required=True)
    results.add_argument("-o", "--output", metavar="SCENE_DIR", help="the scene folder to write")
    results.add_argument(
        "--splat",
        metavar="OUTPUT",
        action="append",
        help="the .ply, .spz, .sog or .glb file to write, of a static scene; repeatable",
    )
    decode.add_argument(
        "--chunks",
        type=_chunks,
        metavar="A:B",
        help="read and write only chunks A to B - 1, counted from 0, and print their digests",
    )
    decode.add_argument(
        "--keep-going",
        action="store_true",
        help="write the undamaged chunks of a damaged file and list the others on stderr; the exit status is still "
        "that of validate",
    )
    digest = add_command(
        commands,
        "digest",
        _digest,
        "print the SHA-256 of a file's reconstruction",
        ["digest scene.c3gs", "digest scene.c3gs --parts"],
    )
    digest.add_argument("file", metavar="FILE", help=FILE)
    add_bounds(digest)
    digest.add_argument(
        "--parts", action="store_true", help="one line for each part of the reconstruction, then the whole"
    )
    reconstruct = add_command(
        commands,
        "reconstruct",
        _reconstruct,
        "write a file's canonical reconstruction (SPEC.md 9.3) after the bytes from which the digest is computed",
        ["reconstruct scene.c3gs scene.bin", "reconstruct scene.c3gs scene.bin --trace symbols.txt --probes"],
        writes=True,
    )
    reconstruct.add_argument("file", metavar="FILE", help=FILE)
    add_bounds(reconstruct)
    reconstruct.add_argument("output", metavar="OUTPUT", help="the file to write")
    reconstruct.add_argument(
        "--trace", metavar="TRACE", help="write a line with path and value to this file for every symbol"
    )
    reconstruct.add_argument(
        "--probes",
        action="store_true",
        help="with --trace: also write the numbers of each anchor, with the names of conformance/README.md",
    )
    validate = add_command(
        commands, "validate", _validate, "check whether a file is a conforming bitstream", ["validate scene.c3gs"]
    )
    validate.add_argument("file", metavar="FILE", help=FILE)
    add_bounds(validate)
