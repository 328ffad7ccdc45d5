"""One way of decoding a file, in a process of its own: python -m benchmarks.decoding WAY FILE

WAY is `whole`; or `digest`, with the SHA-256. The file is decoded to float32 values twice. The process prints, as JSON,
seconds and processor seconds of the second time, those of its parts if it is whole, and the digest if there is one.
Static scenes end with Gaussians.
"""

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from refcodec.bitstream.codec import parse
from refcodec.bitstream.dimensions import STATIC
from refcodec.bitstream.reconstruction import digest, reconstruct
from refcodec.rendering.gaussians import static_splats


def whole(path: Path) -> dict[str, Any]:
    """Decodes a file that is in memory. Returns processor seconds of the parts, and the number of Gaussians."""
    data, start = path.read_bytes(), time.process_time()
    scene = parse(data).scene
    symbols = time.process_time()
    static = scene.render.render_model == STATIC
    made = static_splats(scene) if static else reconstruct(scene)
    parts = {"symbols": symbols - start, "Gaussians" if static else "values": time.process_time() - symbols}
    return {"parts": parts, "count": int(scene.masks.sum()), "arrays": len(vars(made))}


def with_digest(path: Path) -> dict[str, Any]:
    """Decodes a file, and returns its digest, which is that of the values."""
    return {"digest": digest(parse(path.read_bytes()).scene)[0]}


WAYS: dict[str, Callable[[Path], dict[str, Any]]] = {"whole": whole, "digest": with_digest}


def main(way: str, path: Path) -> None:
    """Decodes twice, and prints the figures of the second time."""
    WAYS[way](path)
    seconds, processor = time.perf_counter(), time.process_time()
    made = WAYS[way](path)
    made |= {"seconds": time.perf_counter() - seconds, "processor": time.process_time() - processor}
    print(json.dumps(made))


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
