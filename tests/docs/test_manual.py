"""The manual's code blocks have the results that their pages state, and every command in them exists."""

import importlib
import re
import shlex
import tomllib
from pathlib import Path

import pytest
from blocks import PAGES, ROOT, Block, Desk, blocks, runnable

from conformance.cli.main import main as conformance
from refcodec import api
from refcodec.cli.main import main as refcodec

# What is written here is complete: another mark is a slip.
MARKS = re.compile(r"run(: (trains|it exits with \d+|needs \S+))?|not run: .+")
PROGRAMS = {"refcodec": refcodec, "conformance": conformance}


def _trains(page: Path) -> bool:
    return any(block.mark == "run: trains" for block in blocks(page))


def _marked(page: Path) -> object:
    return pytest.param(page, id=page.stem, marks=[pytest.mark.slow] if _trains(page) else [])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_block_says_whether_it_is_run(page: Path) -> None:
    for block in blocks(page):
        assert MARKS.fullmatch(block.mark), f"{block.page}, line {block.line}: {block.mark!r}"


@pytest.mark.parametrize("page", [_marked(page) for page in PAGES if any(block.runs for block in blocks(page))])
def test_blocks_run(page: Path, tmp_path: Path) -> None:
    desk = Desk(tmp_path)
    for block in runnable(page):
        desk.run(block)


def test_a_block_that_fails_is_seen(tmp_path: Path) -> None:
    """The test above would notice a wrong command, a wrong status and a wrong program."""
    desk = Desk(tmp_path)
    wrong = [
        ("sh", "run", "refcodec validate vectors/none.c3gs"),
        ("sh", "run", "false\ntrue"),
        ("sh", "run: it exits with 1", "true"),
        ("python", "run", "import refcodec\nrefcodec.decode(b'')"),
    ]
    for language, mark, text in wrong:
        with pytest.raises(AssertionError, match=r"page\.md, line 7"):
            desk.run(Block("page.md", 7, language, mark, text))


def _commands(block: Block) -> list[list[str]]:
    """The commands of the project in a block, as words."""
    lines = [line for line in block.text.replace("\\\n", "").splitlines() if line.split(" ", 1)[0] in PROGRAMS]
    return [shlex.split(line, comments=True) for line in lines]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_command_is_understood(page: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Commands and options of blocks that are not run exist, too. With --help behind them, nothing is done."""
    for block in blocks(page):
        if block.language != "sh":
            continue
        for program, *words in _commands(block):
            cut = words.index("--") if "--" in words else len(words)
            known = _options(program, words[0], capsys)
            for word in words[1:cut]:
                if word.startswith("-") and not word.lstrip("-").isdigit():
                    assert word.partition("=")[0] in known, f"{block.page}, line {block.line}: {word}"


def _options(program: str, command: str, capsys: pytest.CaptureFixture[str]) -> set[str]:
    if command.startswith("-"):
        assert PROGRAMS[program](["--help"]) == 0
    else:
        assert PROGRAMS[program]([command, "--help"]) == 0, command
    return set(re.findall(r"(?<![\w-])--?[a-z][\w-]*", capsys.readouterr().out))


def test_the_manual_states_what_an_installation_needs() -> None:
    """The decoder's packages, and the commands of each extra."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    text = (ROOT / "docs" / "first-steps.md").read_text(encoding="utf-8")
    (stated,) = re.findall(r"It needs ([^:]*):", text)
    needed = [re.split(r"\W", line)[0] for line in project["dependencies"]]
    assert sorted(re.split(r",? and |,\s+", stated)) == sorted(needed)
    rows = re.findall(r"^\| `.*", text, re.MULTILINE)
    assert {name for row in rows for name in re.findall(r"`(\w+)`", row.split("|")[1])} <= {
        *project["optional-dependencies"]
    }
    for module, names in api.COMMANDS.items():
        for name in names:
            command = getattr(importlib.import_module(f"{api.__name__}.{module}"), name).command
            if own := command.extra.split(",")[-1]:
                assert any(f"`{own}`" in row.split("|")[1] and f"`{command.name}" in row.split("|")[2] for row in rows)


def test_no_page_is_forgotten() -> None:
    """The manual's first page leads to each of its pages, and the contents of the site have each."""
    index = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    python = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    contents = (ROOT / "docs" / "conf.py").read_text(encoding="utf-8")
    for page in PAGES[1:]:
        assert f"({page.name})" in index + python or page.stem == "index", page.name
        assert f'"{page.stem}"' in contents or page.stem == "index", page.name
