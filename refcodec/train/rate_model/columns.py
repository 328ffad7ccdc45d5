"""The columns of an anchor's attributes, in which order and slices they are coded (SPEC.md 6.13 and 7.10)."""

from dataclasses import dataclass

import torch
from torch import Tensor

from ...bitstream.attributes import KINDS, SCALINGS


@dataclass(frozen=True)
class Columns:
    """Features, scalings and offsets of an anchor, one beside the other.

    slices: the features of each slice. offsets: K.
    """

    slices: tuple[int, ...]
    offsets: int

    @property
    def features(self) -> int:
        """F."""
        return sum(self.slices)

    @property
    def widths(self) -> dict[str, int]:
        """The columns of each kind of attributes, by KINDS."""
        return dict(zip(KINDS, (self.features, SCALINGS, 3 * self.offsets), strict=True))

    @property
    def width(self) -> int:
        """D."""
        return sum(self.widths.values())

    @property
    def carm_inputs(self) -> int:
        """The features that CARM reads. These are all slices but the last."""
        return self.features - self.slices[-1]

    def changes(self) -> Tensor:
        """Columns of CARM's outputs, slice by slice, that means and scales of attributes add: int64 [2, D], or -1."""
        places, done, at = torch.full((2, self.width), -1), self.slices[0], 0
        for columns in self.slices[1:]:
            for row in places:
                row[done : done + columns] = torch.arange(at, at + columns)
                at += columns
            done += columns
        return places
