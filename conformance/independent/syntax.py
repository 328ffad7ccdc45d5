"""Clause 5: the fields of a struct by name, where each of them starts, and padding."""

import struct
from typing import Any

from .conventions import padded
from .errors import require


# SPEC 5
def check_padding(data: bytes, at: int, name: str) -> None:
    """Raise the named error unless the bytes from data[at] to the next multiple of four are zero."""
    require(not any(data[at : padded(at)]), name, at)


class Fields:
    """The values of a header's fields by name, and where each field starts in the file.

    values, offsets: by name of the field.
    """

    def __init__(self, data: bytes, start: int, end: int) -> None:
        """The header is data[start:end]. Its last four bytes are the CRC-32."""
        self._data, self._at, self._end = data, start, end
        self.values: dict[str, Any] = {}
        self.offsets: dict[str, int] = {}

    def __getitem__(self, name: str) -> Any:
        return self.values[name]

    # SPEC 5, [R6.2-3]
    def take(self, layout: str) -> tuple[int, tuple[Any, ...]]:
        """Read the next bytes. Return where they start, and their values. layout: that of `struct`."""
        at, after = self._at, self._at + struct.calcsize(layout)
        require(after <= self._end - 4, "header.syntax", self._end)
        self._at = after
        return at, struct.unpack_from(layout, self._data, at)

    # SPEC 5
    def read(self, name: str, code: str, count: int | None = None) -> Any:
        """Read the next field and return it. code: that of `struct`. count: that of a list, or None for one item."""
        self.offsets[name], items = self.take(f"<{1 if count is None else count}{code}")
        self.values[name] = items[0] if count is None else list(items)
        return self.values[name]

    # SPEC 5
    def read_padding(self) -> tuple[int, bool]:
        """Read padding up to a multiple of four bytes. Return where it starts, and whether it is zero."""
        at, items = self.take(f"<{-self._at % 4}B")
        return at, not any(items)

    # SPEC [R6.2-3], 12.3
    def finish(self, later: bool) -> None:
        """Check that no byte lies between the last field and the CRC-32. later: whether some may lie there."""
        require(later or self._at == self._end - 4, "header.syntax", self._at)

    @property
    def end(self) -> int:
        """The first byte after the header."""
        return self._end
