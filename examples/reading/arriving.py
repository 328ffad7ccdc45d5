"""Decodes a C3GS file chunk by chunk while its bytes arrive, with only one chunk in memory.

curl -s URL | python examples/reading/arriving.py
python examples/reading/arriving.py < scene.c3gs

Each chunk could be drawn at once. All checks are made, and the digest is that of the whole file.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator

from refcodec.bitstream.errors import BitstreamError
from refcodec.bitstream.reader import Reader
from refcodec.bitstream.reconstruction import StreamDigest
from refcodec.bitstream.source import Arriving

BLOCK = 1000


def main() -> int:
    """Reads standard input. Returns the exit status."""
    arrived = 0

    def blocks() -> Iterator[bytes]:
        nonlocal arrived
        while block := sys.stdin.buffer.read(BLOCK):
            arrived += len(block)
            yield block

    try:
        opened = Reader(Arriving(blocks()), keep_ancillary=False).open()
        digest = StreamDigest()
        for chunk in opened.chunks():
            if isinstance(chunk, BitstreamError):
                raise chunk
            digest.add(opened.scene([chunk]))
            print(f"after {arrived} bytes: {len(chunk.positions)} anchors, {int(chunk.masks.sum())} offsets kept")
        opened.close()
    except BitstreamError as error:
        print(error, file=sys.stderr)
        return error.exit_status
    print(f"digest {digest.finish(opened.scene([]))}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
