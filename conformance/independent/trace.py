"""The symbol trace of a file, for comparison with other decoders.

It has a line `PATH VALUE` for each symbol. The symbols of a substream are in the order of its CRC-32 (8.8).
"""

from collections.abc import Iterable, Sequence
from typing import TextIO

# SPEC 7.3: sub-planes 0 to 4
SUB_PLANES = ("r1", "r2.top_left", "r2.top_right", "r2.bottom_left", "r2.bottom_right")


class Trace:
    """Writes the symbols of one substream after the other, in file order."""

    def __init__(self, file: TextIO) -> None:
        self._file = file

    def write(self, names: Iterable[str], values: Iterable[int]) -> None:
        """Write some symbols and their names."""
        self._file.writelines(f"{name} {value}\n" for name, value in zip(names, values))

    # SPEC 5.8, 7.13
    def weights(self, layers: Iterable[tuple[str, int]], values: Iterable[int]) -> None:
        """Write a group of the weights. layers: parts of layers, and how many symbols each has."""
        self.write((f"weights.{part}[{n}]" for part, count in layers for n in range(count)), values)

    # SPEC 7.3
    def wavefront(self, number: int, points: Iterable[tuple[int, int, int]], values: Iterable[int]) -> None:
        """Write a group of a sub-plane. points: (channel, i, j) of each symbol."""
        self.write((f"planes.{SUB_PLANES[number]}[{k},{i},{j}]" for k, i, j in points), values)

    # SPEC 7.12
    def level(self, chunk: int, level: int, lows: Sequence[int], highs: Sequence[int]) -> None:
        """Write the two groups of a level of a chunk's tree."""
        for half, values in (("low", lows), ("high", highs)):
            self.write((f"positions[chunk {chunk}].level[{level}].{half}[{n}]" for n in range(len(values))), values)

    # SPEC 7.6
    def masks(self, first: int, k: int, values: Iterable[int]) -> None:
        """Write bit k of the anchors of a chunk. first: the number of its first anchor."""
        self.write((f"masks[{first + n},{k}]" for n, _ in enumerate(values)), values)

    # SPEC 7.10
    def attributes(self, first: int, features: int, coded: Iterable[Iterable[int]], values: Iterable[int]) -> None:
        """Write a group of a chunk's attributes. first: its first anchor. coded: the channels of each anchor."""
        self.write(
            (f"attributes.{_channel(first + n, c, features)}" for n, channels in enumerate(coded) for c in channels),
            values,
        )


# SPEC 7.7
def _channel(anchor: int, channel: int, features: int) -> str:
    if channel < features:
        return f"features[{anchor},{channel}]"
    if channel < features + 6:
        return f"scalings[{anchor},{channel - features}]"
    offset, axis = divmod(channel - features - 6, 3)
    return f"offsets[{anchor},{offset},{axis}]"
