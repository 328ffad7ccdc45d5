"""The list of what is public, spec/public.txt."""

from pathlib import Path

import pytest

pytest.importorskip("psutil", reason="the commands of conformance need its extra")

from refcodec import api
from spec import public
from spec.made import Made


def test_the_list_is_current() -> None:
    """Who changes what is public adds a line to CHANGELOG.md, and then runs python -m spec."""
    (made,) = public.made()
    assert made.is_current()


def test_the_list_has_the_public_names() -> None:
    lines = public.PAGE.read_text(encoding="utf-8").splitlines()
    for name in api.__all__:
        assert any(line.startswith(f"{name}(") for line in lines), name
    assert any(line.startswith("Camera.look_at(eye: ArrayLike, target: ArrayLike, ") for line in lines)
    assert {"Scene.coded: CodedScene", "Scene.up: NDArray[np.float64]", "BitstreamError.offset: int"} <= set(lines)
    assert any(line.startswith("refcodec encode ") and "--smallest" in line for line in lines)


def test_a_change_needs_a_line_in_the_changelog(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    changes = tmp_path / "CHANGELOG.md"
    monkeypatch.setattr(public, "CHANGES", changes)
    monkeypatch.setattr(public, "PAGE", tmp_path / "public.txt")

    def made(line: str, unreleased: str, released: str) -> Made:
        changes.write_text(f"# Changelog\n\n## Unreleased\n\n{unreleased}\n## 0.1.0\n{released}", encoding="utf-8")
        monkeypatch.setattr(public, "lines", lambda: iter([line]))
        (file,) = public.made()
        return file

    made("old(x: 'int') -> None", "- first\n", "").write()
    # What was released before does not count.
    for released in ("", "- more\n"):
        with pytest.raises(SystemExit, match=r"state it in CHANGELOG\.md"):
            made("new(x: int) -> None", "- first\n", released)
    # Other changes do not need a new list.
    assert made("old(x: int) -> None", "- second\n", "").is_current()
    changed = made("new(x: int) -> None", "- second\n", "")
    assert not changed.is_current()
    assert changed.content.endswith(b"\n\nnew(x: int) -> None\n")
