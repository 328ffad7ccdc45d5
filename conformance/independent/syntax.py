"""Clause 5: the fields of a struct by name, and where each of them starts."""

import struct
from typing import Any

from .errors import require


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
    def read(self, name: str, code: str, count: int | None = None) -> Any:
        """Read the next field and return it. code: that of `struct`. count: that of a list, or None for one item."""
        layout = f"<{1 if count is None else count}{code}"
        size = struct.calcsize(layout)
        require(self._at + size <= self._end - 4, "header.syntax", self._end)
        items = struct.unpack_from(layout, self._data, self._at)
        self.offsets[name] = self._at
        self.values[name] = items[0] if count is None else list(items)
        self._at += size
        return self.values[name]

    # SPEC [R6.2-3]
    def finish(self) -> None:
        """Check that no byte lies between the last field and the CRC-32."""
        require(self._at == self._end - 4, "header.syntax", self._at)

    @property
    def end(self) -> int:
        """The first byte after the header."""
        return self._end
