"""The state of a training run as one safetensors file, without pickles: tensors, and other values as JSON beside them.

The file's metadata has its format, its version and a SHA-256 of everything else. The content is checked against the
expectations of the training run: each name, shape, dtype and range. A state is loaded as it was saved, or refused.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import os
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Protocol

import torch
from msgspec import Meta
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from ..files.documents import FieldError, checked, parse_json
from ..files.interrupts import on_interrupt
from ..files.present import NotAFileError, is_there
from ..files.terminal import note
from ..files.text import printable
from ..photographs.cameras import PhotographError
from ..statuses import UsageError
from .settings_file import differences

# Types of values.
Positive = Annotated[float, Meta(ge=0)]
Share = Annotated[float, Meta(ge=0, le=1)]

FORMAT, VERSION = "C3GS training state", "4"
# The most characters that a message repeats of a value.
_SHOWN = 60


class StateError(UsageError):
    """A saved state that cannot be used. The text is one line, with a remedy."""


class Savable(Protocol):
    """An object whose state can be saved, and that can continue from it."""

    def fingerprint(self) -> dict[str, Any]:
        """The values that must be equal to continue, as JSON values."""

    def state(self) -> dict[str, Any]:
        """All values of its state: tensors, and JSON values."""

    def restore(self, state: Saved) -> None:
        """Restores the values of `state`. Raises ValueError for values that cannot be its state."""


class Saved:
    """The values of a saved state. Names have slashes, and `within` gives those that begin with a part's name.

    Every method raises ValueError for a value that is missing or not allowed.
    """

    def __init__(self, values: Mapping[str, Any], prefix: str = "", read: set[str] | None = None) -> None:
        self._values, self._prefix = values, prefix
        self._read = set() if read is None else read

    def within(self, name: str) -> Saved:
        """Returns the values of a part, by the rest of their names."""
        return Saved(self._values, f"{self._prefix}{name}/", self._read)

    def names(self) -> list[str]:
        return [name.removeprefix(self._prefix) for name in self._values if name.startswith(self._prefix)]

    def fault(self, name: str, problem: str) -> ValueError:
        """Returns the error about a value. problem: its predicate."""
        return ValueError(f"{printable(self._prefix + name, _SHOWN)} {problem}")

    def _take(self, name: str) -> Any:
        """Returns a value, and notes that it was read."""
        whole = self._prefix + name
        if whole not in self._values:
            raise self.fault(name, "is missing")
        self._read.add(whole)
        return self._values[whole]

    def value(self, name: str, kind: Any) -> Any:
        """Returns a JSON value of a type (files.documents.checked)."""
        try:
            return checked(self._take(name), kind)
        except FieldError as error:
            raise self.fault(name, " ".join(filter(None, [error.name, error.problem]))) from None

    def integer(self, name: str, low: int, high: int | None = None) -> int:
        """Returns an integer from low to high."""
        value: int = self.value(name, Annotated[int, Meta(ge=low, le=high)])
        return value

    def tensor(
        self,
        name: str,
        shape: Sequence[int | None],
        dtype: torch.dtype = torch.float32,
        low: float = -math.inf,
        high: float = math.inf,
    ) -> Tensor:
        """Returns a tensor of finite numbers from low to high. shape: None stands for any length."""
        tensor = self._take(name)
        if not isinstance(tensor, Tensor):
            raise self.fault(name, "is not a tensor")
        right = tensor.dim() == len(shape) and all(n in (None, m) for n, m in zip(shape, tensor.shape, strict=True))
        if not right or tensor.dtype != dtype:
            wanted = ", ".join("any" if n is None else str(n) for n in shape)
            raise self.fault(name, f"is {tensor.dtype} {list(tensor.shape)}, but must be {dtype} [{wanted}]")
        if tensor.numel() and not (bool(tensor.isfinite().all()) and low <= tensor.min() and tensor.max() <= high):
            raise self.fault(name, f"has a number that is not finite, or not from {low:g} to {high:g}")
        return tensor

    def module(self, prefix: str, module: nn.Module) -> None:
        """Sets the parameters and buffers of a module, whose names follow the prefix.

        Buffers are units and steps, which are above 0.
        """
        positive = {name for name, _ in module.named_buffers()}
        parameters = {}
        for name, value in module.state_dict().items():
            low = torch.finfo(value.dtype).tiny if name in positive else -math.inf
            parameters[name] = self.tensor(prefix + name, value.shape, value.dtype, low)
        module.load_state_dict(parameters)

    def generator(self, name: str, generator: torch.Generator) -> None:
        """Sets a generator of random numbers."""
        drawn = self.tensor(name, generator.get_state().shape, torch.uint8)
        try:
            generator.set_state(drawn)
        # torch checks the bytes, and raises this type.
        except RuntimeError:
            raise self.fault(name, "is not the state of a random number generator") from None

    def check_all_read(self) -> None:
        """Raises ValueError if there is a value that was not read."""
        for name in sorted(self._values.keys() - self._read):
            raise self.fault(name, "is not known")


def _checksum(notes: Mapping[str, str], tensors: Mapping[str, Tensor]) -> str:
    """Returns the SHA-256 of the notes and tensors: of each name, dtype, shape and content, in the names' order."""
    digest = hashlib.sha256()
    for key in ("format", "version", "of", "values"):
        digest.update(json.dumps([key, notes[key]]).encode())
    for name, value in sorted(tensors.items()):
        digest.update(json.dumps([name, str(value.dtype), list(value.shape)]).encode())
        digest.update(value.reshape(-1).view(torch.uint8).numpy().data)
    return digest.hexdigest()


# --- out --------------------------------------------------------------------------------------------------------------


def save(training: Savable, path: Path) -> None:
    """Writes the state. The file gets its name only when it is whole on the disk.

    Raises OSError or SafetensorError if it cannot be written. The previous state remains unchanged.
    """
    state = training.state()
    tensors = {name: value.detach().clone().contiguous() for name, value in state.items() if isinstance(value, Tensor)}
    values = {name: value for name, value in state.items() if name not in tensors}
    notes = {
        "format": FORMAT,
        "version": VERSION,
        "of": json.dumps(training.fingerprint()),
        "values": json.dumps(values),
    }
    notes["sha256"] = _checksum(notes, tensors)
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(path.name + ".new")
    try:
        save_file(tensors, beside, notes)
        with beside.open("rb") as file:
            os.fsync(file.fileno())
        beside.replace(path)
    except BaseException:
        # An incomplete state takes space that the scene may need.
        with contextlib.suppress(OSError):
            beside.unlink()
        raise


class Keeper:
    """Saves the state of training at intervals. A failure to save does not end training."""

    training: Savable
    path: Path

    def __init__(self, training: Savable, path: Path) -> None:
        self.training, self.path = training, path
        self._reported = False

    def __call__(self) -> None:
        """Saves the state. The first failure is reported on stderr, in one line."""
        try:
            save(self.training, self.path)
        # A failure of safetensors to write is not an OSError.
        except (OSError, SafetensorError) as error:
            if not self._reported:
                kept = _kept(self.path, "the one before is kept", "there is none yet")
                note(
                    f"refcodec: the training's state cannot be saved to {self.path} ({_reason(error)}); {kept}. "
                    "Training continues, and will try again"
                )
                self._reported = True

    def discard(self) -> None:
        """Removes the state, if it exists and can be removed."""
        with contextlib.suppress(OSError):
            self.path.unlink(missing_ok=True)


def run_steps(
    step: Callable[[], None], is_done: Callable[[], bool], keep: Callable[[], None] | None, seconds: float
) -> None:
    """Makes steps of training until its end, or until an interrupt, after which the step at hand is still finished.

    An interrupt is one of the signals of files.interrupts, such as Ctrl-C. keep: saves the state, about every `seconds`
    and after the last step; None saves nothing.
    """
    stop, saved = threading.Event(), time.monotonic()
    with on_interrupt(lambda *_: stop.set()):
        while not is_done() and not stop.is_set():
            step()
            if keep and (time.monotonic() - saved > seconds or stop.is_set() or is_done()):
                keep()
                saved = time.monotonic()


def _kept(path: Path, yes: str, no: str) -> str:
    """A clause about a state for the message of another failure. A further failure here is reported, not raised."""
    try:
        return yes if is_there(path) else no
    except (OSError, NotAFileError) as error:
        return f"cannot check whether {path} exists ({_reason(error)})"


def _reason(error: Exception) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or str(error)


# --- in ---------------------------------------------------------------------------------------------------------------


def is_saved(path: Path) -> bool:
    """Whether there is a saved state. Raises StateError if its path has something else, or cannot be read."""
    try:
        return is_there(path)
    except NotAFileError as error:
        raise _refused(path, str(error)) from None
    except OSError as error:
        raise StateError(f"cannot check whether there is a saved state {path} ({_reason(error)})") from None


def restore(training: Savable, path: Path) -> None:
    """Sets a new training run to the saved state.

    Raises StateError for a file that is damaged, of another version or another training run, or not a state.
    """
    before, saved = _read(path)
    now = training.fingerprint()
    for key in dict.fromkeys([*now, *before]):
        if (one := before.get(key)) != (other := now.get(key)):
            changes = differences(one, other) if isinstance(one, dict) and isinstance(other, dict) else ()
            raise StateError("; ".join([f"the saved state {path} is of other {printable(key, _SHOWN)}", *changes]))
    try:
        training.restore(saved)
        saved.check_all_read()
    except ValueError as error:
        raise _refused(path, str(error)) from None


def _refused(path: Path, problem: str) -> StateError:
    return StateError(
        f"the saved state {path} cannot be used: {problem}; remove it, or write the scene to another folder"
    )


def _read(path: Path) -> tuple[dict[str, Any], Saved]:
    """Returns the fingerprint and the values of a state. Raises StateError."""
    if not is_saved(path):
        raise StateError(f"there is no saved state {path}")
    try:
        with safe_open(path, "pt") as file:
            notes = file.metadata() or {}
            # A tensor of safetensors is a view of the file, whose bytes may change after the check.
            tensors = {name: file.get_tensor(name).clone() for name in file.keys()}  # noqa: SIM118 (not a dictionary)
    except (SafetensorError, OSError, KeyError, TypeError, ValueError) as error:
        raise _refused(path, f"it cannot be read ({_reason(error)})") from None
    if notes.get("format") != FORMAT or notes.get("version") != VERSION:
        stated = printable(" ".join(notes.get(key, "unknown") for key in ("format", "version")), _SHOWN)
        raise _refused(path, f"its format is {stated}, but this program reads only {FORMAT} {VERSION}")
    if not {"of", "values", "sha256"} <= notes.keys() or notes["sha256"] != _checksum(notes, tensors):
        raise _refused(path, "it is damaged (its checksum is wrong)")
    try:
        before, values = parse_json(notes["of"]), parse_json(notes["values"])
    except ValueError as error:
        raise _refused(path, str(error)) from None
    if not isinstance(before, dict) or not isinstance(values, dict):
        raise _refused(path, "its values are not JSON objects")
    return before, Saved({**values, **tensors})


# --- results ----------------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def ending(state: Path) -> Iterator[None]:
    """Says of a ValueError, with which the result of a training cannot be made, where the training is kept.

    state: the path of the saved state. Raises UsageError, and PhotographError of a photograph that is read late.
    """
    try:
        yield
    except PhotographError:
        raise
    except ValueError as error:
        kept = f"{state} keeps it, and --resume with more --steps continues. Or train again"
        advice = _kept(state, kept, "no state could be saved: train again")
        what = f"what was learned does not fit into a file: {error}; {advice}"
        raise UsageError(f"{what} without outliers of the input, or with a larger --lambda") from None


def write_somewhere(write: Callable[[Path], None], output: Path, state: Path) -> None:
    """Writes the result of training, to a second place if its own place fails.

    write: receives the folder to write to. state: the path of the saved state. Raises OSError with the reason and the
    place of the result or of the state.
    """
    try:
        write(output)
    except OSError as error:
        problem = f"the scene cannot be written there ({error.strerror or error})"
        try:
            second = Path(tempfile.mkdtemp(prefix="refcodec-")) / output.name
            write(second)
        except OSError as other:
            nor = f"{problem}, nor among the temporary files ({other.strerror or other})"
            left = _kept(
                state, f"run the same command with --resume to continue from {state}", "no state could be saved"
            )
            raise OSError(error.errno, f"{nor}; {left}", str(output)) from None
        raise OSError(error.errno, f"{problem}; it is in {second}", str(output)) from None
