"""The valid vectors as a suite for Fluster, and a script that runs it there.

Fluster is a runner of conformance suites of decoders that industry uses.

Fluster knows no refusals: of the vectors whose outcome is a digest, it compares the MD5 of the output.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path

from refcodec.bitstream import codec
from refcodec.bitstream.reconstruction import canonical_head, canonical_parts

from ..manifest import Accepted, Manifest

SUITE = "C3GS"
README = "README.md"
_SCRIPT = Path(__file__).with_name("fluster_run.py.txt")

_GUIDE = """# C3GS vectors for Fluster

The valid vectors of the C3GS conformance suite {version}. With Fluster 0.8 or later:

```sh
pip install fluster-conformance
C3GS_DECODER='./mydecoder {{input}} {{output}}' python run.py run -ts {suite} -d C3GS
```

`run.py` is Fluster's own command, told of this folder and of the decoder. `-s -so FILE` writes its table.

The result of a vector is the MD5 of the canonical reconstruction (SPEC.md 9.3) that the decoder writes.
Fluster has no word for a file that must be refused: for those, `conformance run`.
"""


def export(manifest: Manifest, folder: Path) -> int:
    """Writes the suite, its files and the script into a folder; returns the number of vectors."""
    entries = []
    for v in manifest.vectors:
        if not isinstance(v.expectation, Accepted):
            continue
        source = manifest.path(v)
        data = source.read_bytes()
        scene = codec.parse(data).scene
        output = hashlib.md5(canonical_head(scene), usedforsecurity=False)
        for _, part in canonical_parts(scene):
            output.update(part)
        place = folder / "resources" / SUITE / v.id
        place.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source, place / source.name)
        entries.append(
            {
                "name": v.id,
                "source": v.input.path,
                "source_checksum": hashlib.md5(data, usedforsecurity=False).hexdigest(),
                "input_file": source.name,
                "output_format": "None",
                "result": output.hexdigest(),
            }
        )
    suite = {
        "name": SUITE,
        "codec": "None",
        "description": f"C3GS conformance suite {manifest.suite_version}, valid files",
        "test_vectors": entries,
    }
    _write(folder / "test_suites" / "c3gs" / f"{SUITE}.json", json.dumps(suite, indent=4) + "\n")
    _write(folder / "run.py", _SCRIPT.read_text(encoding="utf-8"))
    _write(folder / README, _GUIDE.format(version=manifest.suite_version, suite=SUITE))
    return len(entries)


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
