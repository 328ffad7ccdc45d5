"""Another major version of the format, in a clone: the number, the suite, the worked examples and the shipped scenes.

No verdict and no digest may change by it. What people decide, such as the status of SPEC.md, is listed only.
"""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from conformance.manifest import MANIFEST
from refcodec.bitstream.header import MAJOR, restamped
from refcodec.files.terminal import say
from refcodec.statuses import DONE, REJECTED, UsageError
from spec import version

from . import source

# What a decoder makes of a file. The hash of the file, and what only describes it, are not part of it.
VERDICT = ("class", "operation", "profile", "level", "expectation", "minor_at_most", "budget")


def change(major: int) -> int:
    """Writes another major version everywhere, generates, and compares. Returns an exit status. Raises UsageError."""
    source.commit()
    if major != MAJOR + 1:
        raise UsageError(f"the format is version {MAJOR}, and the next one is {MAJOR + 1}")
    before = _vectors()
    for file in version.made(major):
        file.write()
    scenes = sorted((source.ROOT / "examples" / "scenes").glob("*.c3gs"))
    for scene in scenes:
        scene.write_bytes(restamped(scene.read_bytes(), major))
    for words in (["conformance", "generate"], ["spec"], ["spec", "--check"]):
        if status := subprocess.run([sys.executable, "-m", *words], cwd=source.ROOT, check=False).returncode:
            return status
    after = _vectors()
    differing = [name for name in before if name in after and before[name] != after[name]]
    say(f"== version {major}, with {len(scenes)} scenes of examples; these texts speak of version {MAJOR}:")
    texts = ["git", "grep", "-n", "-I", "-E", f"[Vv]ersion {MAJOR}\\b", "--", "*.md", "*.ksy", ":!CHANGELOG.md"]
    subprocess.run(texts, cwd=source.ROOT, check=False)
    for what, names in (("gone", before.keys() - after), ("new", after.keys() - before), ("differing", differing)):
        say(f"== vectors, {what}: {len(names)} {' '.join(sorted(names))}")
    return REJECTED if differing else DONE


def _vectors() -> dict[str, dict[str, Any]]:
    """Returns what decoders make of each vector of the clone, by its identifier."""
    document = json.loads(Path(source.ROOT, "vectors", MANIFEST).read_text(encoding="utf-8"))
    return {vector["id"]: {name: vector.get(name) for name in VERDICT} for vector in document["vectors"]}
