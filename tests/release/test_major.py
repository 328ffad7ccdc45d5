"""The next major version, made in a clone by `python -m release --major`, and the files of this one, migrated to it."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from conformance.manifest import MANIFEST, VECTORS, Accepted, load
from refcodec.api import digest
from refcodec.bitstream.header import MAJOR

ROOT = VECTORS.parent
# Prints the digest of each file of a folder, migrated to another one.
MIGRATE = """
import sys; from pathlib import Path; from refcodec.api import migrate
for path in sorted(Path(sys.argv[1]).iterdir()):
    print(path.name, migrate(path, Path(sys.argv[2], path.name)).values["digest"])
"""


@pytest.mark.slow
@pytest.mark.skipif(MAJOR > 0 or not (ROOT / ".git").exists(), reason="a clone of version 0 is needed")
def test_the_next_version(tmp_path: Path) -> None:
    """Of the last commit. No verdict changes, and `migrate` makes of each valid file that of the new suite."""
    clone, old, new = tmp_path / "clone", tmp_path / "old", tmp_path / "new"
    subprocess.run(["git", "clone", "--quiet", ROOT, clone], check=True)
    suite = load(clone / "vectors" / MANIFEST)
    digests = {suite.path(v): v.expectation.digest for v in suite.vectors if isinstance(v.expectation, Accepted)}
    digests |= {path: str(digest(path)) for path in (clone / "examples" / "scenes").glob("*.c3gs")}
    old.mkdir()
    new.mkdir()
    for path in digests:
        shutil.copy(path, old)
    for kernel in (ROOT / "refcodec" / "native").glob("kernel*.so"):
        shutil.copy(kernel, clone / "refcodec" / "native")
    environment = {**os.environ, "PYTHONPATH": str(clone)}

    def run(*words: str | Path) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, *words]
        return subprocess.run(command, cwd=clone, env=environment, capture_output=True, text=True, check=False)

    made = run("-m", "release", "--major", str(MAJOR + 1))
    assert "== vectors, differing: 0 " in made.stdout, made.stdout + made.stderr
    assert made.returncode == 0
    assert "commit them" in run("-m", "release", "--major", str(MAJOR + 2)).stderr

    migrated = run("-c", MIGRATE, old, new)
    assert migrated.returncode == 0, migrated.stderr
    found = dict(line.split() for line in migrated.stdout.splitlines())
    assert found == {path.name: value for path, value in digests.items()}
    assert [path for path in digests if (new / path.name).read_bytes() != path.read_bytes()] == []
    refused = run("-m", "refcodec", "validate", old / "plain.c3gs")
    assert refused.returncode == 2
    assert f"refcodec migrate {old / 'plain.c3gs'} -o NEW rewrites" in refused.stderr
