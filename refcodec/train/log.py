"""The log of training: a row for each evaluation on held-out photographs, as a table or for TensorBoard."""

import csv
import io
import re
import stat
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..files.outputs import Kind, check_file
from ..files.present import NotAFileError, is_there
from ..files.stage import write_file
from ..files.terminal import note
from ..statuses import UsageError
from .looks import COLUMNS, PHASE

TABLE = Kind("the log of a training", re.compile(rb"step,seconds,psnr,"))
# The prefix of the names of TensorBoard's files.
_EVENTS = "events.out.tfevents."

Row = Mapping[str, Any]


class Table:
    """A CSV file, which is whole at any time."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def write(self, rows: Sequence[Row]) -> None:
        text = io.StringIO(newline="")
        writer = csv.DictWriter(text, (*COLUMNS, PHASE))
        writer.writeheader()
        writer.writerows(rows)
        write_file(self.path, text.getvalue().encode())


class Board:
    """A folder that TensorBoard reads. Raises ModuleNotFoundError without tensorboard."""

    def __init__(self, folder: Path) -> None:
        # Only this needs it.
        from torch.utils.tensorboard import SummaryWriter  # noqa: PLC0415

        self._folder, self._open = folder, SummaryWriter
        self._writer: Any = None
        self._written = 0

    def write(self, rows: Sequence[Row]) -> None:
        if self._writer is None:
            # Rows after an interrupt replace earlier rows of the same steps.
            self._writer = self._open(str(self._folder), purge_step=rows[0]["step"] if rows else None)
        for row in rows[self._written :]:
            for name in COLUMNS[1:]:
                self._writer.add_scalar(name, row[name], row["step"])
            self._writer.add_text(PHASE, row[PHASE], row["step"])
        self._written = len(rows)
        self._writer.flush()


Log = Table | Board


def check_log(path: Path) -> Path:
    """Returns the file, or a file of the folder, that a log is written to. Raises UsageError for others' files.

    A name that ends with .csv is a table's. Any other is a folder for TensorBoard.
    """
    if path.suffix.lower() == ".csv":
        check_file(path, TABLE)
        return path
    try:
        there = is_there(path, stat.S_IFDIR)
    except NotAFileError:
        raise UsageError(f"{path} is neither a .csv file nor a folder: choose another log") from None
    if there:
        others = [file.name for file in path.iterdir() if not file.name.startswith(_EVENTS)]
        if others:
            raise UsageError(
                f"{path} exists and is not a folder of TensorBoard: choose another one, or name a .csv file"
            )
    return path / _EVENTS


def open_log(path: Path) -> Log:
    """Returns the log at a path. Raises ModuleNotFoundError for a folder without tensorboard."""
    return Table(path) if path.suffix.lower() == ".csv" else Board(path)


class Logging:
    """Writes a log when there is a new row. One that cannot be written does not end the training."""

    log: Log

    def __init__(self, log: Log, rows: Sequence[Row]) -> None:
        """rows: those before the interrupt, if training continues."""
        self.log, self._count, self._said = log, -1 if rows else 0, False

    def __call__(self, rows: Sequence[Row]) -> None:
        """rows: all rows."""
        if len(rows) == self._count:
            return
        self._count = len(rows)
        try:
            self.log.write(rows)
        except OSError as error:
            if not self._said:
                note(f"refcodec: the log cannot be written ({error.strerror or error}); training continues")
                self._said = True
