"""The commands that encode and decode: encode, decode, validate, digest, reconstruct."""

# Modules that need NumPy are imported where they are used, so that help is instant.
# ruff: noqa: PLC0415

from __future__ import annotations

import argparse
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..files.outputs import Kind, check_apart, check_file
from ..files.stage import Stage, write_file
from ..files.terminal import note, say
from ..files.text import printable
from .bounds import add_bounds, check_folder, read_bounded
from .converting import fitted
from .meta import add_meta, metadata_of, with_entries
from .shared import (
    UsageError,
    add_command,
    check_scene_output,
    encoded,
    fit_rate,
    parse_file,
    positive,
    reject,
)

if TYPE_CHECKING:
    from ..bitstream.codec import Parsed

# The lines of a symbol trace (vectors/README.md).
TRACE = Kind("a symbol trace", re.compile(rb"(planes|positions|masks|attributes|weights)\S* -?\d+\n"))


def _encode(arguments: argparse.Namespace) -> int:
    from ..bitstream.header import SIGNATURE
    from ..folder.read import read_folder
    from ..folder.uncompressed import is_uncompressed

    output = Path(arguments.output)
    check_file(output, Kind.signed("a C3GS file", SIGNATURE))
    check_apart([output], [arguments.scene])
    check_folder(arguments, Path(arguments.scene))
    entries = metadata_of(arguments)
    status = 0
    if is_uncompressed(Path(arguments.scene)):
        scene, status = fitted(arguments)
    elif arguments.rate or arguments.steps:
        raise UsageError(f"{arguments.scene} is coded already: --rate and --steps are for uncompressed scenes")
    else:
        scene = read_folder(arguments.scene)
    scene = with_entries(scene, entries)
    write_file(
        output, encoded(arguments, arguments.scene, scene, arguments.positions, arguments.weights, arguments.smallest)
    )
    return status


def _decode(arguments: argparse.Namespace) -> int:
    from ..folder.write import write_folder

    check_scene_output(Path(arguments.output), [arguments.file])
    data = read_bounded(arguments)
    parsed = parse_file(arguments, data, arguments.keep_going)
    write_folder(parsed.scene, arguments.output, parsed.damage)
    return _report_damage(arguments.file, data, parsed) if arguments.keep_going else 0


def _report_damage(path: str, data: bytes, parsed: Parsed) -> int:
    """Reports each dropped chunk on stderr, and then the verdict on the file. It is the same that validate gives."""
    from ..bitstream.codec import parse_container

    if parsed.damage:
        header = parse_container(data)
        for number, error in sorted(parsed.damage.items()):
            note(f"chunk {number} is dropped, {parsed.lost[number]} anchors: {error}")
        left = parsed.scene.anchor_count
        lost = sum(parsed.lost.values())
        note(f"{len(parsed.damage)} of {header.chunk_count} chunks and {lost} anchors are lost, {left} are written")
    elif parsed.error:
        note("every chunk is whole, but the file is damaged elsewhere")
    return reject(path, parsed.error) if parsed.error else 0


def _validate(arguments: argparse.Namespace) -> int:
    from ..bitstream import cameras, metadata
    from ..bitstream.limits import PROFILES

    scene = parse_file(arguments, read_bounded(arguments)).scene
    for warning in (*metadata.warnings(scene.ancillary), *cameras.warnings(scene.ancillary)):
        note(f"warning: {printable(warning)}")
    say(f"{arguments.file} is accepted: profile {PROFILES[scene.profile].name}, {scene.anchor_count} anchors")
    return 0


def _digest(arguments: argparse.Namespace) -> int:
    from ..bitstream.reconstruction import digest

    whole, parts = digest(parse_file(arguments, read_bounded(arguments)).scene)
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
    check_file(output, Kind.signed("a reconstruction", DIGEST_MAGIC))
    if trace:
        check_file(trace, TRACE)
    check_apart([output, *([trace] if trace else [])], [arguments.file])
    data = read_bounded(arguments)
    with Stage() as stage:
        if trace:
            from ..inspect.trace import symbol_trace

            lines = stage.open(trace)
            scene = symbol_trace(data, lambda text: lines.write(text.encode())).scene
        else:
            scene = parse_file(arguments, data).scene
        whole = stage.open(output)
        for part in (digested(scene), *(part for _, part in canonical_parts(scene))):
            whole.write(part)
    return 0


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
            "encode converted -o scene.c3gs --rate 0.01",
        ],
        "A folder that decode wrote gives the same bytes again. For a file of Main, add --positions raw if its\n"
        "positions are raw, and --weights raw if its weights are raw. If coded.safetensors is deleted,\n"
        "point_cloud.ply is quantised anew. An uncompressed scene, of convert or of train --rate 0, is quantised and\n"
        "gets an entropy model, as by fit. That takes minutes, and needs: pip install 'refcodec[fit]'.",
        writes=True,
    )
    encode.add_argument("scene", metavar="SCENE_DIR")
    add_bounds(encode)
    encode.add_argument("-o", "--output", metavar="FILE", required=True)
    add_meta(encode)
    encode.add_argument(
        "--positions",
        choices=("raw", "packed"),
        help="48 bits an anchor, or about a tenth of that with the anchors sorted (default: packed in Main, and where "
        "the folder says so)",
    )
    encode.add_argument(
        "--weights",
        choices=("raw", "packed"),
        help="32 bits each, or the integers that those of the coding networks act as (default: as for --positions)",
    )
    encode.add_argument(
        "--smallest",
        action="store_true",
        help="also try the scene without a hyperprior and with raw positions, and write the smallest file; no "
        "position, mask or attribute changes; for scenes of few anchors, such as fit makes",
    )
    encode.add_argument(
        "--rate",
        type=fit_rate,
        metavar="L",
        help="lambda_r for an uncompressed scene: its steps grow with the root (default: 0.004)",
    )
    encode.add_argument(
        "--steps", type=positive, metavar="N", help="training steps of an uncompressed scene's model (default: 4000)"
    )
    decode = add_command(
        commands,
        "decode",
        _decode,
        "decode a file into a scene folder",
        ["decode scene.c3gs -o scene", "decode damaged.c3gs -o scene --keep-going"],
        "SCENE_DIR is made. An existing one is written to only if it is empty or a scene folder. Its scene is\n"
        "replaced as a whole, and other files in it stay.",
        writes=True,
    )
    decode.add_argument("file", metavar="FILE")
    add_bounds(decode)
    decode.add_argument("-o", "--output", metavar="SCENE_DIR", required=True)
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
    digest.add_argument("file", metavar="FILE")
    add_bounds(digest)
    digest.add_argument(
        "--parts", action="store_true", help="one line for each part of the reconstruction, then the whole"
    )
    reconstruct = add_command(
        commands,
        "reconstruct",
        _reconstruct,
        "write a file's canonical reconstruction (SPEC.md 9.3), behind the 252 bytes that the digest is of",
        ["reconstruct scene.c3gs scene.bin", "reconstruct scene.c3gs scene.bin --trace symbols.txt"],
        writes=True,
    )
    reconstruct.add_argument("file", metavar="FILE")
    add_bounds(reconstruct)
    reconstruct.add_argument("output", metavar="OUTPUT")
    reconstruct.add_argument(
        "--trace", metavar="TRACE", help="write every symbol to this file, a line with its path and its value each"
    )
    validate = add_command(
        commands, "validate", _validate, "check whether a file is a conforming bitstream", ["validate scene.c3gs"]
    )
    validate.add_argument("file", metavar="FILE")
    add_bounds(validate)
