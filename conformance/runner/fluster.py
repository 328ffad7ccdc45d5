"""The valid vectors as a suite for Fluster, and a script that runs it there.

Fluster is a runner for the conformance suites of video decoders.

Fluster does not support refusals. For each vector with a digest it compares the MD5 of the output.
"""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path

from refcodec.bitstream import codec
from refcodec.bitstream.header import SIGNATURE
from refcodec.bitstream.reconstruction import canonical_parts, digested
from refcodec.files.lock import hold_folder
from refcodec.files.outputs import Kind, check_apart, check_file
from refcodec.files.stage import Stage

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

`run.py` calls Fluster's command with this folder and the decoder. `-s -so FILE` writes its table.

The result of a vector is the MD5 of the canonical reconstruction (SPEC.md 9.3) that the decoder writes.
Fluster does not support files that must be refused. Use `conformance run` for them.
"""

# The files of an earlier export.
_LIST = Kind("a suite of this command", re.compile(rb'\{\n    "name": "C3GS",\n    "codec": "None"'))
_RUN = Kind.signed("the script of this command", b'"""Fluster on the C3GS suite beside this file')
_TEXT = Kind.signed("the guide of this command", b"# C3GS vectors for Fluster\n")
_VECTOR = Kind.signed("a C3GS file", SIGNATURE)


def export(manifest: Manifest, folder: Path) -> int:
    """Writes the suite, its files and the script into a folder, all or none. Returns the number of vectors.

    Raises UsageError, before the work, if a file would replace one of another kind, or is in the folder of the suite.
    """
    fixed = {_list_of(folder): _LIST, folder / "run.py": _RUN, folder / README: _TEXT}
    sources = [manifest.path(v) for v in manifest.vectors]
    check_apart(fixed, [manifest.folder, *sources])
    for path, kind in fixed.items():
        check_file(path, kind, made=True)
    with hold_folder(folder), Stage() as stage:
        return _export(manifest, folder, stage)


def _export(manifest: Manifest, folder: Path, stage: Stage) -> int:
    entries = []
    for v in manifest.vectors:
        if not isinstance(v.expectation, Accepted):
            continue
        source = manifest.path(v)
        data = source.read_bytes()
        scene = codec.parse(data).scene
        output = hashlib.md5(digested(scene), usedforsecurity=False)
        for _, part in canonical_parts(scene):
            output.update(part)
        place = folder / "resources" / SUITE / v.id / source.name
        check_file(place, _VECTOR, made=True)
        stage.write(place, data)
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
    stage.write(_list_of(folder), (json.dumps(suite, indent=4) + "\n").encode())
    stage.write(folder / "run.py", _SCRIPT.read_bytes())
    stage.write(folder / README, _GUIDE.format(version=manifest.suite_version, suite=SUITE).encode())
    return len(entries)


def _list_of(folder: Path) -> Path:
    return folder / "test_suites" / "c3gs" / f"{SUITE}.json"
