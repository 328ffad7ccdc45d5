"""Compares images with reference images (vectors/README.md), as SPEC [G14.5-1] demands."""

import math
import re

import numpy as np
from numpy.typing import NDArray

# SPEC [G14.5-1]: the least PSNR in dB, the largest error of a channel, and the share of pixels that may exceed it.
PSNR, CHANNEL, SHARE = 50.0, 4 / 255, 1 / 1000
# Type, width, height and byte order of a PFM file.
_HEAD = re.compile(rb"PF\n([0-9]{1,5}) ([0-9]{1,5})\n(-?)[0-9.]{1,9}\n")


def read_pfm(data: bytes) -> NDArray[np.float32]:
    """Returns the image of a PFM file in colours, [height, width, 3], the uppermost row first. Raises ValueError."""
    head = _HEAD.match(data)
    if head is None:
        raise ValueError("no PFM file in colours")
    width, height, little = int(head[1]), int(head[2]), head[3]
    if len(data) - head.end() != 12 * width * height:
        raise ValueError(f"a PFM file of {width} x {height} pixels has {12 * width * height} bytes of numbers")
    values = np.frombuffer(data, "<f4" if little else ">f4", offset=head.end())
    # The last row comes first.
    return values.reshape(height, width, 3)[::-1].astype(np.float32)


def image_difference(expected: bytes, output: bytes) -> str | None:
    """Returns how an image differs from a reference image beyond the tolerance, in words, or None. Both are PFM."""
    right = read_pfm(expected).astype(np.float64)
    try:
        made = read_pfm(output).astype(np.float64)
    except ValueError as wrong:
        return f"the output is {wrong}"
    if made.shape != right.shape:
        return f"{made.shape[1]} x {made.shape[0]} pixels, {right.shape[1]} x {right.shape[0]} expected"
    error = np.abs(made - right)
    if not np.isfinite(error).all():
        return "a number is not finite"
    mean = float((error**2).mean())
    psnr = -10 * math.log10(mean) if mean else math.inf
    beyond = error.max(axis=2) > CHANNEL
    if psnr >= PSNR and beyond.sum() <= SHARE * beyond.size:
        return None
    row, column = np.unravel_index(int(error.max(axis=2).argmax()), beyond.shape)
    return (
        f"{psnr:.2f} dB, and {int(beyond.sum())} of {beyond.size} pixels differ by more than 4/255; row {row}, column "
        f"{column} is {made[row, column].tolist()}, {right[row, column].tolist()} expected"
    )
