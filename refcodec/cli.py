"""The command line. Modules that need NumPy are imported by the commands that use them, so that help is instant."""

# ruff: noqa: PLC0415

from __future__ import annotations

import argparse
import contextlib
import os
import shlex
import stat
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from . import __version__
from .errors import BitstreamError

if TYPE_CHECKING:
    from .codec import Parsed, Progress
    from .scene import Scene
    from .uncompressed import Uncompressed

# Exit statuses. 1 and 2 are verdicts on a bitstream (SPEC.md 10.1); the others never are.
EXIT_REJECTED = 1
EXIT_USAGE = 64
EXIT_FAULT = 70
EXIT_INTERRUPTED = 130
EXIT_BROKEN_PIPE = 141

# Section offsets are u32, so a longer file is only read as far as its own header says.
_WHOLE_FILE_MAX = (1 << 32) - 1
_HEAD_BYTES = 1 << 17

_EXITS = """\
exit status:
  0   accepted, or done
  1   the file is rejected      } the last line on stderr is JSON:
  2   the file is not supported } code, name, offset, path, clause
  64  wrong usage, or a file or folder that cannot be read or written
  70  a fault of this program
"""


class UsageError(Exception):
    """Something that the caller can put right; exit status 64."""


class _Parser(argparse.ArgumentParser):
    """argparse, with exit status 64 instead of 2, which would read as a verdict."""

    def error(self, message: str) -> NoReturn:
        self.print_usage(sys.stderr)
        self.exit(EXIT_USAGE, f"{self.prog}: {message}\n")


def _note(text: str) -> None:
    print(text, file=sys.stderr)


# --- files ------------------------------------------------------------------------------------------------------------


def _read_file(path: str) -> bytes:
    """A whole file. Of one that is too long, or endless, no more is read than its header announces, and one byte.

    Raises UsageError if it cannot be read, BitstreamError if it is too long to be read before its header is accepted.
    """
    try:
        with open(path, "rb") as file:
            status = os.fstat(file.fileno())
            if stat.S_ISREG(status.st_mode) and status.st_size <= _WHOLE_FILE_MAX:
                return file.read()
            head = file.read(_HEAD_BYTES)
            if len(head) < _HEAD_BYTES:
                return head
            end = _announced_length(head)
            if stat.S_ISREG(status.st_mode) and status.st_size != end:
                raise BitstreamError("directory.file_length", min(status.st_size, end), "file", f"{status.st_size} bytes", end)
            return head + file.read(max(0, end - len(head)) + 1)
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror or error}") from None


def _announced_length(head: bytes) -> int:
    """Where the last section of a file ends; head: its beginning. Raises BitstreamError for what comes before that check."""
    from . import syntax
    from .container import PROLOGUE_BYTES, parse_container

    try:
        parse_container(head)
    except BitstreamError as error:
        if error.kind.name not in ("directory.file_length", "section.crc"):
            raise
    header, _ = syntax.parse("Header", head, PROLOGUE_BYTES)
    return int(header.directory[-1].offset + header.directory[-1].length)


def _check_output_file(path: Path, signature: bytes, kind: str) -> None:
    """Before any work is done: that _write_file may write there; signature, kind: of the files that it may replace."""
    if path.is_dir():
        raise UsageError(f"{path} is a directory: give the name of a file")
    if not path.parent.is_dir():
        raise UsageError(f"there is no directory {path.parent}")
    if path.is_file() and path.stat().st_size:
        with path.open("rb") as file:
            if file.read(len(signature)) != signature:
                raise UsageError(f"{path} exists and is not {kind}: choose another name, or remove it")


def _write_file(path: Path, data: bytes) -> None:
    """A file that takes its name when it is whole; a pipe or a device is written as it is."""
    if path.exists() and not path.is_file():
        path.write_bytes(data)
        return
    path = path.resolve()
    handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        # mkstemp makes files private; a result has the rights that open would have given it.
        mask = os.umask(0)
        os.umask(mask)
        os.chmod(temporary, 0o666 & ~mask)
        os.replace(temporary, path)
    except BaseException:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(temporary)
        raise


def _check_output_folder(path: str) -> None:
    """Before any work is done: that write_folder will accept the folder."""
    from .folder import is_free

    if not is_free(Path(path)):
        raise UsageError(f"{path} exists and is not a scene folder: choose another one, or empty it")


# --- progress and verdicts --------------------------------------------------------------------------------------------


@contextlib.contextmanager
def _progress(wanted: bool) -> Iterator[Progress]:
    """A progress bar on stderr for what takes more than a second; off unless stderr is a terminal or it is wanted."""
    if not (wanted or sys.stderr.isatty()):
        yield lambda stage, done, total: None
        return
    from tqdm import tqdm

    bars: dict[str, Any] = {}

    def show(stage: str, done: int, total: int) -> None:
        if stage not in bars:
            for finished in bars.values():
                finished.close()
            bars[stage] = tqdm(total=total, desc=stage, file=sys.stderr, delay=0 if wanted else 1, leave=wanted)
        bars[stage].update(done - bars[stage].n)

    try:
        yield show
    finally:
        for bar in bars.values():
            bar.close()


def _reject(path: str, error: BitstreamError) -> int:
    """Reports a verdict on stderr: a line for people, then a line of JSON."""
    word = "is not supported" if error.kind.klass == "unsupported" else "is rejected"
    sys.stdout.flush()
    _note(f"{path} {word}: {error}. To see the spot: refcodec inspect {shlex.quote(path)} --near {error.offset}")
    _note(error.to_json())
    return error.exit_status


def _parse(arguments: argparse.Namespace, data: bytes, keep_going: bool = False) -> Parsed:
    from .codec import parse

    with _progress(arguments.progress) as progress:
        return parse(data, keep_going=keep_going, progress=progress)


# --- commands ---------------------------------------------------------------------------------------------------------


def _encode(arguments: argparse.Namespace) -> int:
    from .codec import emit
    from .container import SIGNATURE
    from .folder import read_folder
    from .quantise import packed

    output = Path(arguments.output)
    _check_output_file(output, SIGNATURE, "a C3GS file")
    scene = read_folder(arguments.scene)
    try:
        with _progress(arguments.progress) as progress:
            data = emit(packed(scene, arguments.positions, arguments.weights), progress=progress)
    except ValueError as error:
        raise UsageError(f"{arguments.scene} cannot be encoded: {error}") from None
    _write_file(output, data)
    return 0


def _decode(arguments: argparse.Namespace) -> int:
    from .folder import write_folder

    data = _read_file(arguments.file)
    _check_output_folder(arguments.output)
    parsed = _parse(arguments, data, arguments.keep_going)
    write_folder(parsed.scene, arguments.output, parsed.damage)
    return _report_damage(arguments.file, data, parsed) if arguments.keep_going else 0


def _report_damage(path: str, data: bytes, parsed: Parsed) -> int:
    """Each dropped chunk on stderr, then the verdict that validate gives, which writing a part of the file does not change."""
    from .container import parse_container

    if parsed.damage:
        chunks = parse_container(data, keep_going=True).chunks
        lost = sum(len(chunks[number]) for number in parsed.damage)
        for number, error in sorted(parsed.damage.items()):
            _note(f"chunk {number} is dropped, {len(chunks[number])} anchors: {error}")
        _note(f"{len(parsed.damage)} of {len(chunks)} chunks and {lost} anchors are lost, {parsed.scene.anchor_count} are written")
    try:
        parse_container(data)
    except BitstreamError as error:
        if not parsed.damage:
            _note("every chunk is whole, but the file is damaged elsewhere")
        return _reject(path, error)
    if not parsed.damage:
        return 0
    # SPEC 10.1: the error of an earlier stage comes first, then that of a lower chunk.
    stages = {"positions": 0, "masks": 1, "attributes": 2}
    return _reject(path, min(parsed.damage.items(), key=lambda found: (stages[found[1].path.split("[")[0]], found[0]))[1])


def _digest(arguments: argparse.Namespace) -> int:
    from .reconstruction import digest

    whole, parts = digest(_parse(arguments, _read_file(arguments.file)).scene)
    if arguments.parts:
        for name, value in {**parts, "whole": whole}.items():
            print(f"{name:<10} {value}")
    else:
        print(whole)
    return 0


def _reconstruct(arguments: argparse.Namespace) -> int:
    from .reconstruction import DIGEST_MAGIC, canonical_head, canonical_parts

    output = Path(arguments.output)
    _check_output_file(output, DIGEST_MAGIC, "a reconstruction")
    data = _read_file(arguments.file)
    if arguments.trace:
        from .inspection import symbol_trace

        with open(arguments.trace, "w", encoding="utf-8", newline="\n") as file:
            scene = symbol_trace(data, file.write).scene
    else:
        scene = _parse(arguments, data).scene
    _write_file(output, b"".join([canonical_head(scene), *(part for _, part in canonical_parts(scene))]))
    return 0


def _gaussians(arguments: argparse.Namespace) -> int:
    import json

    from .reconstruction import reconstruct
    from .rendering import gaussians, gaussians_document, read_camera

    output = Path(arguments.output)
    _check_output_file(output, b'{"gaussians":', "a list of Gaussians")
    try:
        camera = read_camera(Path(arguments.camera).read_text(encoding="utf-8"))
    except ValueError as error:
        raise UsageError(f"{arguments.camera} is no camera: {error}") from None
    scene = _parse(arguments, _read_file(arguments.file)).scene
    found = gaussians(reconstruct(scene), scene.masks, scene.networks, camera, scene.render.distance_unit)
    _write_file(output, json.dumps(gaussians_document(found), separators=(",", ":")).encode())
    return 0


def _validate(arguments: argparse.Namespace) -> int:
    from .limits import PROFILES

    scene = _parse(arguments, _read_file(arguments.file)).scene
    print(f"{arguments.file} is accepted: profile {PROFILES[scene.profile].name}, {scene.anchor_count} anchors")
    return 0


def _fit(arguments: argparse.Namespace) -> int:
    from zipfile import BadZipFile

    from .folder import read_cloud, write_folder

    try:
        from .fit.fitter import fit
        from .fit.voxelise import default_voxel, read_points, short_mantissa, voxelise
    except ModuleNotFoundError as error:
        raise _needs("fit", "fit", error, ("torch", "scipy")) from None
    _check_output_folder(arguments.output)
    # Beside the folder, not in it: a scene folder is whole or it is not there.
    state = Path(f"{arguments.output.rstrip('/')}.fit-state")
    if arguments.resume and not state.exists():
        raise UsageError(f"there is nothing to resume: {state} does not exist")
    voxel = arguments.voxel and short_mantissa(arguments.voxel)
    try:
        if arguments.points.endswith(".ply"):
            cloud = read_cloud(arguments.points)
        else:
            found = read_points(arguments.points)
            voxel = voxel or default_voxel(found.points)
            cloud = voxelise(found.points, found.colours, voxel)
        if not arguments.resume:
            state.unlink(missing_ok=True)
        with _progress(arguments.progress) as progress:
            result = fit(cloud, voxel=voxel, steps=arguments.steps, seed=arguments.seed, progress=progress, state=state)
    # Of the npz files that cannot be read some are no archives, and some are cut.
    except (ValueError, BadZipFile, EOFError) as error:
        raise UsageError(f"{arguments.points} cannot be fitted: {error}") from None
    write_folder(result.scene, arguments.output)
    done, dropped = result.report["steps"], result.report["dropped"]
    print(f"{arguments.output}: {result.scene.anchor_count} anchors, {dropped} without offsets left out, {done} steps")
    # Ctrl-C ends the training, not the program.
    if done < arguments.steps and state.exists():
        _note(f"refcodec: stopped at step {done} of {arguments.steps}; the scene is written, and --resume goes on from there")
        return EXIT_INTERRUPTED
    state.unlink(missing_ok=True)
    return 0


def _train(arguments: argparse.Namespace) -> int:
    try:
        from .train.command import PRESETS, may_write, state_path, train
        from .train.trainer import TrainSettings
    except ModuleNotFoundError as error:
        raise _needs("train", "train", error, ("torch", "numba", "scipy", "PIL", "skimage")) from None
    output = Path(arguments.output.rstrip("/") or "/")
    if not may_write(output):
        raise UsageError(f"{output} exists and is not a scene folder: choose another one, or empty it")
    if arguments.resume and not state_path(output).exists():
        raise UsageError(f"there is nothing to resume: {state_path(output)} does not exist")
    preset = PRESETS[arguments.preset]
    photographs = _photographs(arguments.photographs, arguments.size or str(preset["side"]))
    settings = TrainSettings(
        rate=arguments.rate,
        steps=arguments.steps or preset["steps"],
        seed=arguments.seed,
        hyperprior=arguments.hyperprior,
        uniform=arguments.sampling == "uniform",
        plane_period=arguments.plane_period,
        masks=not arguments.no_masks,
        epsilon=arguments.epsilon,
        anchors=preset["anchors"],
        most_anchors=preset["most_anchors"],
    )
    try:
        trainer, whole = train(
            photographs,
            settings,
            output,
            threads=arguments.threads or os.cpu_count() or 1,
            device=arguments.device,
            resume=arguments.resume,
            progress=arguments.progress,
        )
    except ValueError as error:
        raise UsageError(f"{arguments.photographs} cannot be trained: {error}") from None
    print(f"{output}: {trainer.scaffold.count} anchors, {trainer.done} steps, {trainer.seconds:.0f} s")
    if not whole:
        _note(f"refcodec: stopped at step {trainer.done} of {settings.steps}; the scene is written, and --resume goes on from there")
        return EXIT_INTERRUPTED
    return 0


def _needs(command: str, extra: str, error: ModuleNotFoundError, packages: tuple[str, ...]) -> UsageError:
    """What to install for a command. Raises the error again if it is not one of the extra's packages that is missing."""
    if (error.name or "").split(".")[0] not in packages:
        raise error
    return UsageError(f"{command} needs {error.name}: pip install 'refcodec[{extra}]'")


_RENDER_PACKAGES = ("numba", "PIL", "skimage", "scipy")


def _photographs(folder: str, size: str | None) -> Any:
    """The photographs of a folder. Raises UsageError."""
    from .train.photographs import PhotographError, parse_size, read_photographs

    try:
        return read_photographs(folder, parse_size(size) if size else None)
    except (PhotographError, ValueError) as error:
        raise UsageError(str(error)) from None


def _uncompressed(path: str) -> Uncompressed | None:
    """An uncompressed scene, if the path is the folder of one."""
    from .uncompressed import is_uncompressed, read_uncompressed

    return read_uncompressed(Path(path)) if is_uncompressed(Path(path)) else None


def _render(arguments: argparse.Namespace) -> int:
    try:
        from .viewing import View, eight_bits, own_camera, write_gif, write_png
    except ModuleNotFoundError as error:
        raise _needs("render", "render", error, _RENDER_PACKAGES) from None
    view = View(_uncompressed(arguments.file) or _parse(arguments, _read_file(arguments.file)).scene)
    if arguments.cameras == "default":
        cameras = [own_camera(view.info)]
    elif arguments.cameras == "orbit":
        cameras = view.orbit(arguments.frames)
    else:
        found = _photographs(arguments.cameras, arguments.size)
        cameras = [p.camera for p in (*found.test, *found.train)]
    folder = Path(arguments.output)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"cannot make {folder}: {error.strerror}") from None
    frames = []
    with _progress(arguments.progress) as progress:
        for number, camera in enumerate(cameras):
            progress("images", number, len(cameras))
            try:
                made = view.draw(camera)
            except ValueError as error:
                raise UsageError(f"{arguments.file} cannot be drawn: {error}") from None
            path = folder / f"{Path(camera.name).stem}.png"
            write_png(path, made)
            if arguments.cameras == "orbit":
                frames.append(eight_bits(made))
        progress("images", len(cameras), len(cameras))
    if frames:
        write_gif(folder / "orbit.gif", frames)
    print(f"{folder}: {len(cameras)} images" + (", orbit.gif" if frames else ""))
    return 0


def _lpips(path: str) -> Any:
    """LPIPS with the weights of a file. Raises UsageError."""
    try:
        from .train.lpips import Lpips
    except ModuleNotFoundError as error:
        raise _needs("eval --lpips", "fit", error, ("torch",)) from None
    try:
        return Lpips(path)
    except ValueError as error:
        raise UsageError(str(error)) from None


def _eval(arguments: argparse.Namespace) -> int:
    import json

    try:
        from .evaluation import evaluate, table
        from .train.cameras import PhotographError
    except ModuleNotFoundError as error:
        raise _needs("eval", "render", error, _RENDER_PACKAGES) from None
    lpips = _lpips(arguments.lpips) if arguments.lpips else None
    shown = _uncompressed(arguments.file) or _read_file(arguments.file)
    found = _photographs(arguments.photographs, arguments.size)
    try:
        with _progress(arguments.progress) as progress:
            result = evaluate(shown, found, Path(arguments.images) if arguments.images else None, progress, lpips)
    except PhotographError as error:
        raise UsageError(str(error)) from None
    except ValueError as error:
        raise UsageError(f"{arguments.file} cannot be drawn: {error}") from None
    result = {"file": arguments.file, **result}
    print(json.dumps(result, indent=1) if arguments.json else "\n".join(table(result)))
    return 0


def _demo(arguments: argparse.Namespace) -> int:
    try:
        from .train.demo import STEPS, find_example, run_demo
        from .train.photographs import PhotographError
        from .train.runs import RunError
    except ModuleNotFoundError as error:
        raise _needs("demo", "train,render", error, _RENDER_PACKAGES) from None
    try:
        photographs = Path(arguments.photographs) if arguments.photographs else find_example(arguments.scene)
        page, whole = run_demo(Path(arguments.output), photographs, arguments.steps or STEPS)
    except PhotographError as error:
        raise UsageError(str(error)) from None
    except RunError as error:
        _note(f"refcodec: {error}")
        return error.status
    print(f"The page: {page.resolve().as_uri()}")
    return 0 if whole else EXIT_INTERRUPTED


def _rd(arguments: argparse.Namespace) -> int:
    try:
        from .train.command import PRESETS
        from .train.photographs import PhotographError
        from .train.rd import FIGURES, Settings, run_rd
        from .train.runs import RunError
    except ModuleNotFoundError as error:
        raise _needs("rd", "train,render,rd", error, ("matplotlib", "bjontegaard", "torch", *_RENDER_PACKAGES)) from None
    options = [("--steps", arguments.steps), ("--preset", arguments.preset), ("--device", arguments.device), ("--seed", arguments.seed)]
    given = tuple(word for name, value in options if value is not None for word in (name, str(value)))
    size = arguments.size or str(PRESETS[arguments.preset]["side"])
    settings = Settings(Path(arguments.output), Path(arguments.photographs), given, size, arguments.jobs)
    rates = sorted({*arguments.rates, *([0.0] if arguments.uncompressed else [])})
    try:
        rows, difference = run_rd(settings, rates, Path(arguments.against) if arguments.against else None)
    except PhotographError as error:
        raise UsageError(str(error)) from None
    except RunError as error:
        _note(f"refcodec: {error}")
        return error.status
    print(f"{'rate':>8} {'bytes':>10} {'anchors':>8}" + "".join(f" {name:>10}" for name in FIGURES))
    for row in rows:
        figures = "".join(f" {row[name]:>10.4f}" for name in FIGURES)
        print(f"{row['rate']:>8g} {row['bytes']:>10.0f} {row['anchors']:>8.0f}{figures}")
    if difference:
        print(f"BD-rate {difference.rate:+.2f} %, BD-PSNR {difference.psnr:+.3f} dB against {arguments.against}")
        if difference.warning:
            _note(f"refcodec: {difference.warning}")
    return 0


def _spots(data: bytes, error: BitstreamError) -> list[BitstreamError]:
    """An error, and those of the single chunks: the CRC-32 of a section only says that one of its bytes is wrong."""
    from .codec import parse

    with contextlib.suppress(BitstreamError):
        chunks = parse(data, keep_going=True).damage
        return [error, *(found for found in chunks.values() if found.to_json() != error.to_json())]
    return [error]


def _show_anchor(scene: Scene, number: int) -> int:
    from .inspection import anchor_rows

    try:
        for what, clause, values in anchor_rows(scene, number):
            print(f"{what:<45} {clause:<6} {values}")
    except IndexError:
        raise UsageError(f"there is no anchor {number}: the file has {scene.anchor_count}") from None
    return 0


def _inspect(arguments: argparse.Namespace) -> int:
    import json

    from . import inspection

    data = _read_file(arguments.file)
    if arguments.trace:
        inspection.trace(data, sys.stdout.write)
        return 0
    if arguments.anchor is not None:
        return _show_anchor(_parse(arguments, data).scene, arguments.anchor)
    error: BitstreamError | None = None
    try:
        verdict: Parsed | BitstreamError = _parse(arguments, data)
    except BitstreamError as found:
        verdict = error = found
    if arguments.hex or arguments.near is not None:
        lines = inspection.hex_lines(data, _spots(data, error) if error else [], arguments.near)
    elif arguments.json:
        lines = iter([json.dumps(inspection.document(data, verdict), indent=1)])
    else:
        lines = inspection.summary(inspection.document(data, verdict), arguments.file)
    for line in lines:
        print(line)
    return _reject(arguments.file, error) if error else 0


# --- arguments --------------------------------------------------------------------------------------------------------


def _positive(text: str) -> int:
    """An integer from 1."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text} found, at least 1 required")
    return value


def _seed(text: str) -> int:
    """An integer that every generator of random numbers takes."""
    value = int(text)
    if not 0 <= value < 1 << 63:
        raise argparse.ArgumentTypeError(f"{text} found, 0 to 2^63 - 1 allowed")
    return value


def _weight(text: str) -> float:
    """A number from 0 to 1."""
    value = float(text)
    if not 0 <= value <= 1:
        raise argparse.ArgumentTypeError(f"{text} found, 0 to 1 allowed")
    return value


def _length(text: str) -> float:
    """A finite length above 0."""
    value = float(text)
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text} found, a number above 0 required")
    return value


def _rate(text: str) -> float:
    """A lambda_r of the paper, above 0."""
    value = float(text)
    if not 0 < value <= 1:
        raise argparse.ArgumentTypeError(f"{text} found, above 0 to 1 allowed")
    return value


def _add(
    commands: Any, name: str, run: Callable[[argparse.Namespace], int], text: str, examples: list[str], notes: str = ""
) -> argparse.ArgumentParser:
    """A command, with its examples and the exit statuses in its help."""
    epilog = "examples:\n" + "".join(f"  refcodec {e}\n" for e in examples) + "\n" + (notes + "\n\n" if notes else "") + _EXITS
    parser: argparse.ArgumentParser = commands.add_parser(
        name, help=text, description=text[0].upper() + text[1:] + ".", epilog=epilog, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--progress", action="store_true", help="show progress on stderr even if it is not a terminal")
    parser.set_defaults(run=run)
    return parser


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="refcodec",
        description="Reference encoder and decoder of C3GS, a bitstream for learned 3D Gaussian scenes.",
        epilog=f"examples:\n  refcodec validate scene.c3gs\n  refcodec decode scene.c3gs -o scene\n\n{_EXITS}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"refcodec {__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)

    encode = _add(
        commands,
        "encode",
        _encode,
        "encode a scene folder",
        ["encode scene -o scene.c3gs"],
        "A folder that decode wrote from a packed file, or from one of Tiny, gives the same bytes again, and so does any other\nwith "
        "--positions raw --weights raw. If coded.safetensors is deleted, point_cloud.ply is quantised anew.",
    )
    encode.add_argument("scene", metavar="SCENE_DIR")
    encode.add_argument("-o", "--output", metavar="FILE", required=True)
    encode.add_argument(
        "--positions",
        choices=("raw", "packed"),
        help="48 bits an anchor, or a tenth of that with the anchors sorted (default: packed in Main, and where the folder says so)",
    )
    encode.add_argument(
        "--weights",
        choices=("raw", "packed"),
        help="32 bits each, or those of the coding networks as the integers that they act as (default: as --positions)",
    )
    decode = _add(
        commands,
        "decode",
        _decode,
        "decode a file into a scene folder",
        ["decode scene.c3gs -o scene", "decode damaged.c3gs -o scene --keep-going"],
        "SCENE_DIR is made; an existing one is overwritten only if it is empty or a scene folder.",
    )
    decode.add_argument("file", metavar="FILE")
    decode.add_argument("-o", "--output", metavar="SCENE_DIR", required=True)
    decode.add_argument(
        "--keep-going",
        action="store_true",
        help="write the undamaged chunks of a damaged file and list the others on stderr; the exit status is 1 all the same "
        "if anything is lost, and 0 if nothing is",
    )
    digest = _add(
        commands, "digest", _digest, "print the SHA-256 of a file's reconstruction", ["digest scene.c3gs", "digest scene.c3gs --parts"]
    )
    digest.add_argument("file", metavar="FILE")
    digest.add_argument("--parts", action="store_true", help="one line for each part of the reconstruction, then the whole")
    reconstruct = _add(
        commands,
        "reconstruct",
        _reconstruct,
        "write a file's canonical reconstruction (SPEC.md 9.3), the numbers that its digest is of",
        ["reconstruct scene.c3gs scene.bin", "reconstruct scene.c3gs scene.bin --trace symbols.txt"],
    )
    reconstruct.add_argument("file", metavar="FILE")
    reconstruct.add_argument("output", metavar="OUTPUT")
    reconstruct.add_argument("--trace", metavar="TRACE", help="write every symbol to this file: a line with its path and its value")
    gaussians = _add(
        commands,
        "gaussians",
        _gaussians,
        "write the Gaussians that a camera sees (SPEC.md 14.3) as JSON",
        ["gaussians scene.c3gs camera.json gaussians.json"],
        "CAMERA is a JSON object; vectors/README.md says which.",
    )
    gaussians.add_argument("file", metavar="FILE")
    gaussians.add_argument("camera", metavar="CAMERA")
    gaussians.add_argument("output", metavar="OUTPUT")
    validate = _add(commands, "validate", _validate, "check whether a file is a conforming bitstream", ["validate scene.c3gs"])
    validate.add_argument("file", metavar="FILE")
    inspect = _add(
        commands,
        "inspect",
        _inspect,
        "show what a file is made of",
        [
            "inspect scene.c3gs",
            "inspect scene.c3gs --hex | less",
            "inspect scene.c3gs --near 1106",
            "inspect scene.c3gs --trace | head -100",
            "inspect scene.c3gs --anchor 7",
        ],
        "Damaged files are shown as far as they parse, and then rejected as by validate.",
    )
    inspect.add_argument("file", metavar="FILE")
    form = inspect.add_mutually_exclusive_group()
    form.add_argument("--hex", action="store_true", help="every byte with its syntax element; payloads folded to a line each")
    form.add_argument("--near", type=int, metavar="OFFSET", help="the same, of the elements around a byte")
    form.add_argument("--json", action="store_true", help="the summary as one JSON document")
    form.add_argument("--trace", action="store_true", help="one line per syntax element and symbol, in decoding order")
    form.add_argument("--anchor", type=int, metavar="N", help="all numbers from an anchor's position to its symbols, as in Annex D.4")
    render = _add(
        commands,
        "render",
        _render,
        "draw a file",
        ["render scene.c3gs -o images", "render scene.c3gs --cameras orbit -o images", "render scene.c3gs --cameras photographs -o images"],
        "PHOTOGRAPHS is a folder that COLMAP or a NeRF dataset made. An orbit is an animation too. Needs: pip install 'refcodec[render]'.",
    )
    render.add_argument("file", metavar="FILE")
    render.add_argument("-o", "--output", metavar="DIR", required=True)
    render.add_argument("--cameras", metavar="default|orbit|PHOTOGRAPHS", default="default", help="which cameras (default: the file's own)")
    render.add_argument("--size", metavar="WxH", help="size of the images, or their longest side, with PHOTOGRAPHS")
    render.add_argument("--frames", type=_positive, metavar="N", default=60, help="images of an orbit (default: %(default)s)")
    evaluate = _add(
        commands,
        "eval",
        _eval,
        "compare what a file shows with photographs",
        ["eval scene.c3gs photographs", "eval scene.c3gs photographs --size 400x300 --json"],
        "On the images that were held out: every eighth, or the test set of the dataset. Needs: pip install 'refcodec[render]'.",
    )
    evaluate.add_argument("file", metavar="FILE")
    evaluate.add_argument("photographs", metavar="PHOTOGRAPHS")
    evaluate.add_argument("--size", metavar="WxH", help="size that photographs are averaged down to, or their longest side")
    evaluate.add_argument("--images", metavar="DIR", help="where to write the images that were compared, as PNG files")
    evaluate.add_argument("--lpips", metavar="WEIGHTS", help="LPIPS too, with the weights of a file that tools/lpips_weights.py makes")
    evaluate.add_argument("--json", action="store_true", help="all figures, of each image too")
    train = _add(
        commands,
        "train",
        _train,
        "learn a scene from photographs, and write a scene folder",
        [
            "train photographs -o scene",
            "train photographs -o scene --rate 0.01 --steps 8000",
            "train photographs -o scene --resume",
            "train photographs -o scaffold --rate 0",
        ],
        "PHOTOGRAPHS is a folder that COLMAP or a NeRF dataset made; every eighth image is held out. Then: refcodec encode SCENE_DIR.\n"
        "Ctrl-C ends the training early, writes the scene all the same, and keeps SCENE_DIR.train-state for --resume.\n"
        "Needs: pip install 'refcodec[train]'.",
    )
    train.add_argument("photographs", metavar="PHOTOGRAPHS")
    train.add_argument("-o", "--output", metavar="SCENE_DIR", required=True)
    train.add_argument(
        "--rate",
        type=_weight,
        metavar="L",
        default=0.004,
        help="lambda_r, the weight of the rate: 0.002 to 0.04, or 0 for an uncompressed Scaffold-GS (default: %(default)s)",
    )
    train.add_argument("--steps", type=_positive, metavar="N", help="training steps (default: the preset's)")
    train.add_argument(
        "--preset",
        choices=("fast", "paper"),
        default="fast",
        help="fast: 4,000 steps on photographs of 400 pixels; paper: 40,000 on 1,600 (default: %(default)s)",
    )
    train.add_argument("--size", metavar="WxH", help="size that photographs are averaged down to, or their longest side")
    train.add_argument("--seed", type=_seed, metavar="S", default=0, help="of the random numbers (default: %(default)s)")
    train.add_argument("--device", choices=("cpu", "cuda"), default="cpu", help="what rasterises; cuda needs pip install 'refcodec[cuda]'")
    train.add_argument("--threads", type=_positive, metavar="N", help="of the rasteriser (default: all); no result depends on them")
    train.add_argument("--resume", action="store_true", help="go on with an interrupted training of the same photographs and settings")
    paper = train.add_argument_group("what the paper compares")
    paper.add_argument(
        "--hyperprior",
        choices=("vm", "plane", "triplane", "triplane72"),
        default="vm",
        help="only vm can be written; the others are for estimates (default: %(default)s)",
    )
    paper.add_argument("--sampling", choices=("uniform", "visible"), default="uniform", help="anchors whose rate counts: USRO or ViSRO")
    paper.add_argument("--plane-period", type=int, choices=(1, 4), default=4, help="steps between two with the planes' rate (A-RDO: 4)")
    paper.add_argument("--no-masks", action="store_true", help="keep every offset")
    paper.add_argument(
        "--epsilon",
        type=_length,
        metavar="E",
        default=0.01,
        help="share below which an offset is masked; 0.0004 where views are concentrated",
    )
    demo = _add(
        commands,
        "demo",
        _demo,
        "train on the photographs that come with the project, code the scene, and make a page of the results",
        ["demo", "demo -o out --scene snowmiku", "demo -o out --steps 600", "demo -o out --photographs my-photographs"],
        "DIR/index.html shows everything; it takes about six minutes on two cores. Ctrl-C ends the training early and shows what there\n"
        "is; the same command goes on, and does nothing twice. Needs: pip install 'refcodec[train,render]'.",
    )
    demo.add_argument("-o", "--output", metavar="DIR", default="demo", help="folder of the results (default: %(default)s)")
    which = demo.add_mutually_exclusive_group()
    which.add_argument("--scene", choices=("caliterra", "snowmiku"), default="caliterra", help="which photographs (default: %(default)s)")
    which.add_argument("--photographs", metavar="FOLDER", help="your own, of COLMAP or a NeRF dataset")
    demo.add_argument("--steps", type=_positive, metavar="N", help="steps of each training (default: those of four minutes)")
    rd = _add(
        commands,
        "rd",
        _rd,
        "train at several rates, and write the sizes and figures as a table and a chart",
        [
            "rd photographs -o curve --size 400x300",
            "rd photographs -o curve --rates 0.002 0.004 0.01 0.04 --uncompressed",
            "rd photographs -o curve --against other/rd.csv",
        ],
        "DIR gets rd.csv, rd.png, and for each rate a scene folder, a file and its figures. The same command goes on with what was\n"
        "interrupted, and does nothing twice. Needs: pip install 'refcodec[train,render,rd]'.",
    )
    rd.add_argument("photographs", metavar="PHOTOGRAPHS")
    rd.add_argument("-o", "--output", metavar="DIR", required=True)
    rd.add_argument(
        "--rates", type=_rate, nargs="+", metavar="R", default=[0.002, 0.004, 0.01, 0.04], help="lambda_r (default: 0.002 0.004 0.01 0.04)"
    )
    rd.add_argument("--uncompressed", action="store_true", help="a training without the codec too")
    rd.add_argument("--against", metavar="CSV", help="a table with columns bytes and psnr: BD-rate and BD-PSNR with that curve as anchor")
    rd.add_argument("--jobs", type=_positive, metavar="N", default=2, help="trainings at a time (default: %(default)s)")
    rd.add_argument("--size", metavar="WxH", help="size that photographs are averaged down to, or their longest side")
    rd.add_argument("--preset", choices=("fast", "paper"), default="fast", help="as of train (default: %(default)s)")
    for name, kind in (("steps", _positive), ("seed", _seed), ("device", str)):
        rd.add_argument(f"--{name}", type=kind, help="as of train")
    fit = _add(
        commands,
        "fit",
        _fit,
        "fit an entropy model to points or to a trained scene, and write a scene folder",
        ["fit points3D.txt -o scene", "fit point_cloud.ply -o scene --steps 6000", "fit points3D.txt -o scene --resume"],
        "POINTS is a COLMAP points3D.txt, an .npz with means3d and colors, or a Scaffold-GS, HAC or CAT-3DGS point_cloud.ply with\n"
        "10 offsets and 50 features. The rendering networks are simple ones that show coloured points. Ctrl-C ends the training\n"
        "early, writes the scene all the same, and keeps SCENE_DIR.fit-state for --resume. Needs: pip install 'refcodec[fit]'.",
    )
    fit.add_argument("points", metavar="POINTS")
    fit.add_argument("-o", "--output", metavar="SCENE_DIR", required=True)
    fit.add_argument("--steps", type=_positive, metavar="N", default=4000, help="training steps (default: %(default)s)")
    fit.add_argument(
        "--voxel",
        type=_length,
        metavar="V",
        help="edge of the anchors' lattice, in world units (default: median distance of the points; none for a .ply)",
    )
    fit.add_argument("--seed", type=_seed, metavar="S", default=0, help="of the random numbers (default: %(default)s)")
    fit.add_argument("--resume", action="store_true", help="go on with an interrupted fit of the same points")
    return parser


def main(argv: list[str] | None = None) -> int:
    """Runs one command; returns its exit status."""
    # Read when numba or torch is loaded: threads that wait do not spin, which on busy cores makes training ten times as slow.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    arguments = None
    try:
        arguments = _parser().parse_args(argv)
        status: int = arguments.run(arguments)
        sys.stdout.flush()
        return status
    except SystemExit as end:
        # argparse leaves this way for --help, --version and wrong usage.
        return int(end.code or 0)
    except BitstreamError as error:
        return _reject(arguments.file, error)  # type: ignore[union-attr]
    except BrokenPipeError:
        # The reader of stdout went away; what is left to write must not fail again when Python closes it.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_BROKEN_PIPE
    except KeyboardInterrupt:
        _note("refcodec: interrupted")
        return EXIT_INTERRUPTED
    except Exception as error:
        return _report(error)


def _report(error: Exception) -> int:
    """The exit status of an error that is no verdict."""
    folder = sys.modules.get("refcodec.folder")
    if isinstance(error, UsageError) or (folder is not None and isinstance(error, folder.SceneFolderError)):
        _note(f"refcodec: {error}")
        return EXIT_USAGE
    if isinstance(error, OSError):
        _note(f"refcodec: {error.filename or 'output'}: {error.strerror or error}")
        return EXIT_USAGE
    if os.environ.get("REFCODEC_DEBUG") == "1":
        raise error
    kind = type(error).__name__
    _note(f"refcodec: internal error, please report it with the command and the file ({kind}: {' '.join(str(error).split())})")
    return EXIT_FAULT
