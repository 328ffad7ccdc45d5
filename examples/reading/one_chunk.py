"""Fetches the byte ranges of one chunk of a C3GS file, and decodes it.

python examples/reading/one_chunk.py FILE_OR_URL NUMBER

A viewer does this for the visible part of a scene. It first fetches the header, the networks, the planes and the index,
which serve every chunk. The index states the location, the maximum number of Gaussians and the bounding box of each
chunk. A URL needs a server that supports range requests.
"""

from __future__ import annotations

import sys
import urllib.request
from collections.abc import Callable
from pathlib import Path

from refcodec.bitstream.reader import decode_chunk
from refcodec.bitstream.reconstruction import chunk_digest, reconstruct
from refcodec.bitstream.source import Ranges


def fetcher(place: str) -> tuple[Callable[[int, int], bytes], int]:
    """Returns a function that fetches bytes by offset and size, and the length of the file."""
    if "://" not in place:
        data = Path(place)

        def read(start: int, size: int) -> bytes:
            with data.open("rb") as file:
                file.seek(start)
                return file.read(size)

        return read, data.stat().st_size

    def fetch(start: int, size: int) -> bytes:
        wanted = urllib.request.Request(place, headers={"Range": f"bytes={start}-{start + size - 1}"})
        with urllib.request.urlopen(wanted, timeout=30) as answer:
            if answer.status != 206:
                raise OSError("the server does not support range requests: download the file, and give its path")
            return answer.read()

    with urllib.request.urlopen(urllib.request.Request(place, method="HEAD"), timeout=30) as answer:
        return fetch, int(answer.headers["Content-Length"])


def main() -> None:
    """Command line."""
    if len(sys.argv) != 3:
        raise SystemExit(__doc__)
    place, number = sys.argv[1], int(sys.argv[2])
    fetch, length = fetcher(place)

    def reported(start: int, size: int) -> bytes:
        print(f"fetch {size} bytes from {start}")
        return fetch(start, size)

    scene = decode_chunk(Ranges(reported, length), number)
    values = reconstruct(scene)
    low, high = values.positions.min(axis=0), values.positions.max(axis=0)
    print(f"chunk {number}: {scene.anchor_count} anchors from {low.tolist()} to {high.tolist()}")
    print(f"digest {chunk_digest(scene)}")


if __name__ == "__main__":
    main()
