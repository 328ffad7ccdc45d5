"""The release: archives, wheels and descriptions. `python -m release --check` builds the whole."""

import contextlib
import io
import os
import re
import shutil
import subprocess
import tarfile
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from refcodec import __version__
from refcodec.bitstream.header import MAJOR
from refcodec.statuses import UsageError
from release import archives, audit, compiler, notices, wheels
from release.source import SourceTree

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
SOURCE = SourceTree(ROOT, "c" * 40, 1_700_000_000, "0.1.0", "0.1.0")
INFO = "refcodec-0.1.0.dist-info/"


@pytest.fixture(autouse=True)
def _without_the_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    """The licences of its parts are texts: the extra `release` may be missing."""
    monkeypatch.setattr(notices, "text", lambda *parts: ", ".join(part.name for part in parts).encode())


def whole() -> dict[str, bytes]:
    """The files of a wheel of the whole tree, with a few of its modules."""
    return {
        "refcodec/__init__.py": b"",
        "conformance/__init__.py": b"",
        "conformance/data/vectors/manifest.json": b"{}",
        f"{INFO}METADATA": b"Metadata-Version: 2.4\nName: refcodec\nVersion: 0.1.0\nLicense-File: LICENSE\n\nWords.\n",
        f"{INFO}WHEEL": b"Wheel-Version: 1.0\nGenerator: x\nRoot-Is-Purelib: true\nTag: py3-none-any\n\n",
        f"{INFO}entry_points.txt": b"",
        f"{INFO}top_level.txt": b"",
        f"{INFO}licenses/LICENSE": b"",
        f"{INFO}RECORD": b"",
    }


def test_an_archive_depends_on_names_and_contents_only(tmp_path: Path) -> None:
    files = {"b/run": b"2", "a": b"1"}
    made = archives.tar_gz(files, 7, frozenset({"b/run"}))
    assert made == archives.tar_gz(dict(reversed(files.items())), 7, frozenset({"b/run"}))
    # Of files with other times, owners, modes and order.
    other = io.BytesIO()
    with tarfile.open(fileobj=other, mode="w:gz") as archive:
        for name, content in files.items():
            member = tarfile.TarInfo(name)
            member.size, member.mtime, member.uid, member.uname = len(content), len(name), 1000, "somebody"
            member.mode = 0o775 if name == "b/run" else 0o660
            archive.addfile(member, io.BytesIO(content))
    assert archives.same_tar_gz(other.getvalue(), 7) == made
    with tarfile.open(fileobj=io.BytesIO(made)) as archive:
        members = [(m.name, m.mode, m.mtime, m.uid, m.uname) for m in archive.getmembers()]
    assert members == [("a", 0o644, 7, 0, ""), ("b/run", 0o755, 7, 0, "")]


def test_a_source_distribution_is_the_same_twice(tmp_path: Path) -> None:
    made = []
    for number in (1, 2):
        folder = tmp_path / f"{number}"
        (folder / "one").mkdir(parents=True)
        (folder / "pyproject.toml").write_text(
            '[build-system]\nrequires = ["setuptools"]\nbuild-backend = "setuptools.build_meta"\n'
            '[project]\nname = "one"\nversion = "1"\n',
            encoding="utf-8",
        )
        module = folder / "one" / "__init__.py"
        module.write_text("", encoding="utf-8")
        module.chmod(0o640 if number == 1 else 0o644)
        os.utime(module, (number, number))
        made.append(archives.same_tar_gz(wheels.build(folder, "build_sdist", 7), 7))
    assert made[0] == made[1]


def test_a_wheel_has_codec_and_suite(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """What setuptools built, the licences of the parts, and a record of all."""
    monkeypatch.setattr(wheels, "build", lambda *_: archives.zipped(whole(), 0))
    (path,) = wheels.plain(SOURCE, tmp_path)
    wheel = archives.members(path.read_bytes())
    assert set(wheel) == {*whole(), f"{INFO}licenses/{notices.FILE}"}
    assert wheel[f"{INFO}METADATA"].decode().count(f"License-File: {notices.FILE}\n") == 1
    record = wheel[f"{INFO}RECORD"].decode().splitlines()
    assert {line.partition(",")[0] for line in record} == set(wheel)


def test_every_part_goes_with_its_licence() -> None:
    names = {target.name: [part.name for part in notices.parts(target.tag)] for target in compiler.TARGETS}
    assert names["Windows x86_64"] == ["wasi-libc", "zig compiler-rt", "mingw-w64"]
    assert names["Linux x86_64"] == ["wasi-libc", "zig compiler-rt"]
    assert notices.parts(wheels.ANY) == [notices.WASI]


def test_one_compiler_is_pinned() -> None:
    """The extra has the compiler that package.json names."""
    pinned = {Requirement(t).name: Requirement(t) for t in PROJECT["optional-dependencies"]["release"]}
    assert str(pinned["ziglang"].specifier) == f"=={compiler.package(SOURCE)['config']['ziglang']}"
    exact = {name for name, r in pinned.items() if str(r.specifier).startswith("==")}
    assert {"setuptools", "ziglang", "markdown-it-py", "pygments"} <= exact


def test_a_target_has_its_tag() -> None:
    """The processor and the oldest system of a wheel's tag are those that the compiler gets."""
    names = {"manylinux": "gnu", "musllinux": "musl", "macosx": "macos", "win": "windows"}
    for target in compiler.TARGETS:
        tag, zig = target.tag.split(".")[0], target.zig.replace("aarch64-macos", "arm64-macos")
        assert names[re.split(r"[_0-9]", tag)[0]] in zig
        assert tag.replace("amd64", "x86_64").endswith(zig.partition("-")[0])
        for version in re.findall(r"\d+\.\d+$", zig):
            assert f"_{version.replace('.', '_')}_" in tag


@pytest.mark.parametrize(
    ("library", "exports", "tag", "fault"),
    [
        ("libc.so.6", {audit.FIRST}, "manylinux_2_17_x86_64", None),
        ("libgcc_s.so.1", {audit.FIRST}, "manylinux_2_17_x86_64", "it needs libgcc_s.so.1"),
        ("libc.so.6", set(), "manylinux_2_17_x86_64", "it does not export kernel_version"),
        ("libc.so.6", {audit.FIRST}, "macosx_10_13_x86_64", "it needs libc.so.6"),
        ("/usr/lib/libSystem.B.dylib", {audit.FIRST}, "macosx_11_0_arm64", "it has no signature"),
        ("KERNEL32.dll", {audit.FIRST}, "win_amd64", None),
        ("vcruntime140.dll", {audit.FIRST}, "win_amd64", "vcruntime140.dll"),
    ],
)
def test_a_library_that_a_system_may_not_load_is_refused(
    monkeypatch: pytest.MonkeyPatch, library: str, exports: set[str], tag: str, fault: str | None
) -> None:
    monkeypatch.setattr(audit, "facts", lambda _: audit.Facts((library,), frozenset(exports)))
    target = compiler.System("a system", "", tag)
    with pytest.raises(UsageError, match=re.escape(fault)) if fault else contextlib.nullcontext():
        audit.check_kernel(b"", target)


def test_the_citation_is_current() -> None:
    """CITATION.cff, from which Zenodo takes the deposit, states what the package does."""
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    for line in (f"version: {__version__}", f"license: {PROJECT['license']}", f"name: {PROJECT['authors'][0]['name']}"):
        assert f"{line}\n" in citation


@pytest.mark.skipif(shutil.which("file") is None, reason="file(1) is not here")
def test_file_knows_the_format() -> None:
    """spec/c3gs.magic, which tests/spec/test_descriptions.py compares with the tables."""
    command = ["file", "--brief", "-m", ROOT / "spec" / "c3gs.magic", ROOT / "vectors" / "tiny-example.c3gs"]
    printed = subprocess.run([*command, ROOT / "SPEC.md"], capture_output=True, text=True, check=True).stdout
    words, other = printed.splitlines()
    assert words == f"C3GS scene of 3D Gaussians, version {MAJOR}.0, profile Tiny level 0, anchors: 5, chunks: 2"
    assert not other.startswith("C3GS")
