"""The place of a training's result: the scene folder, and the saved state beside it, checked before any work."""

import contextlib
import os
import re
from pathlib import Path

from ..files.lock import hold_file
from ..files.outputs import Kind
from ..files.present import NotAFileError, is_there
from ..statuses import UsageError

# A saved training is a safetensors file with notes.
STATE = Kind(
    "the saved state of a training",
    re.compile(rb'.{8}\{"__metadata__":\{"(format|of|sha256|values|version)":"', re.DOTALL),
)
REPORT = Kind("the report of a training", re.compile(rb'\{\n "settings": '))


def named(output: str | os.PathLike[str]) -> Path:
    """Returns the path of a folder with a name, beside which a state can be saved. Raises UsageError for the root."""
    path = Path(output)
    if path.name in ("", ".."):
        path = Path(os.path.abspath(path))
    if not path.name:
        raise UsageError(f"{path} is not a scene folder: choose another one")
    return path


def check_state(output: Path, state: Path, resume: bool, advice: str = "") -> None:
    """Raises UsageError if a result cannot be written, a saved state to resume is missing, or one would be lost.

    advice: added to the message on a missing state. Raises OSError if the state cannot be looked up.
    """
    try:
        if resume and not is_there(state):
            raise UsageError(f"there is nothing to resume: {state} does not exist{advice}")
    except NotAFileError as error:
        raise UsageError(f"there is nothing to resume: {state}: {error}") from None
    if not resume and os.path.lexists(state):
        raise UsageError(
            f"{state} is the saved state of a training into the same folder: continue it with --resume, or remove it"
        )
    above = next(path for path in (output, *output.absolute().parents) if path.exists())
    if not os.access(above, os.W_OK | os.X_OK):
        raise UsageError(f"{output} cannot be written: {above} is read-only; choose another folder")


def hold_state(state: Path) -> contextlib.AbstractContextManager[None]:
    """Holds the lock of a saved state, so that no other run trains into the same folder. Raises UsageError."""
    return hold_file(state.with_name(state.name + ".lock"))


def stopped(done: int, steps: int, state: Path) -> str:
    """Returns the message about a training that was interrupted, and whose scene is written."""
    kept = os.path.lexists(state)
    advice = "--resume continues from the saved state" if kept else "there is no saved state to continue from"
    return f"refcodec: stopped at step {done} of {steps}; the scene is written, and {advice}"
