"""An experiment's file is read strictly, and its cells match the file."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

for package in ("PIL", "scipy", "matplotlib", "bjontegaard"):
    pytest.importorskip(package, reason="experiments need the packages of the extras train, render and rd")

from refcodec.experiments import plan  # noqa: E402
from refcodec.experiments.cells import cells, hash_of  # noqa: E402
from refcodec.experiments.plan import ExperimentError, read_experiment  # noqa: E402
from refcodec.train.settings_file import differences, document  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]
FILES = ROOT / "benchmarks" / "experiments"
TEXT = """
rates = [0.01, 0.004]
seeds = [0, 7]
steps = 5
baseline = "a"
[[scenes]]
name = "one"
photographs = "one"
size = 40
[[scenes]]
name = "two"
photographs = "${SOMEWHERE}/two"
background = "white"
holdout = 5
anchors = 700
rates = [0.5]
set = ["masks.epsilon=0.02", "growth.most=99"]
[[methods]]
name = "a"
[[methods]]
name = "b"
set = ["masks.epsilon=0.03"]
scenes = ["two"]
[[methods]]
name = "whole"
kind = "uncompressed"
scenes = ["one"]
"""


def read(folder: Path, text: str = TEXT) -> plan.Experiment:
    path = folder / "x.toml"
    path.write_text(text)
    return read_experiment(path)


def test_the_cells(tmp_path: Path) -> None:
    experiment = read(tmp_path)
    names = [cell.name for cell in cells(experiment)]
    assert names == [
        *(f"one/a/rate-{rate}/seed-{seed}" for rate in ("0.004", "0.01") for seed in (0, 7)),
        *(f"one/whole/rate-0/seed-{seed}" for seed in (0, 7)),
        *(f"two/{method}/rate-0.5/seed-{seed}" for method in "ab" for seed in (0, 7)),
    ]
    assert [cell.name for cell in cells(experiment, ("*/b/*seed-7", "one/whole/*-0"))] == [names[4], names[9]]
    one, whole, two = (next(cells(experiment, (name,))) for name in (names[0], names[4], names[8]))
    train, encode, shown = one.commands(Path("w"), Path("photographs"), 3)
    words = "train photographs -o w/scene --preset fast --lambda 0.004 --seed 0 --size 40 --steps 5"
    assert list(train.arguments) == words.split()
    assert train.free == ("--threads", "3", "--progress")
    assert list(encode.arguments) == ["encode", "w/scene", "-o", "w/scene.c3gs"]
    assert list(shown.arguments) == ["eval", "w/scene.c3gs", "photographs", "--size", "40", "--json"]
    assert (encode.after, shown.after) == ((train.name,), (encode.name,))
    train, shown = whole.commands(Path("w"), Path("photographs"), 3)
    assert train.arguments[train.arguments.index("--lambda") + 1] == "0"
    assert list(shown.arguments) == ["eval", "w/scene", "photographs", "--size", "40", "--json"]
    assert shown.after == (train.name,)
    train, _, shown = two.commands(Path("w"), Path("photographs"), 3)
    words = "--size 400 --holdout 5 --background white --steps 5 --set start.anchors=700 --set masks.epsilon=0.02"
    assert words in " ".join(train.arguments)
    # The file has the background.
    assert list(shown.arguments[3:]) == ["--size", "400", "--holdout", "5", "--json"]
    assert (two.settings.background, two.settings.holdout, two.settings.start.anchors) == ("white", 5, 700)
    # What a method sets is set after what the scene sets.
    assert (two.settings.masks.epsilon, two.settings.growth.most) == (0.03, 99)
    assert (two.settings.rate.lambda_r, two.settings.steps, two.settings.seed, two.settings.size) == (0.5, 5, 0, "400")


def test_settings_are_those_of_the_command(tmp_path: Path) -> None:
    """The settings in a definition are what `refcodec train` makes of the cell's command."""
    from refcodec.cli.learning import _settings  # noqa: PLC0415
    from refcodec.cli.main import GROUPS, make_parser  # noqa: PLC0415

    for cell in cells(read(tmp_path)):
        train = cell.commands(Path("w"), Path("photographs"), 1)[0]
        assert _settings(make_parser(list(GROUPS)).parse_args([*train.arguments, *train.free])) == cell.settings


def test_where_photographs_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    experiment = read(tmp_path)
    one, two = experiment.scenes
    assert experiment.photographs(one) == tmp_path / "one"
    monkeypatch.delenv("SOMEWHERE", raising=False)
    with pytest.raises(ExperimentError, match="set the variable SOMEWHERE"):
        experiment.photographs(two)
    monkeypatch.setenv("SOMEWHERE", "/data")
    assert experiment.photographs(two) == Path("/data/two")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("steps = 5", "stops = 5", "has stops: its keys are scenes, methods"),
        ("steps = 5", "steps = 0", "steps is 0"),
        ("steps = 5", "steps = true", "steps is True"),
        ("steps = 5", "steps = 5.0", "steps is 5.0"),
        ("steps = 5", 'device = "tpu"', "cpu or cuda"),
        ("steps = 5", "device = [1]", "cpu or cuda"),
        ("[0.01, 0.004]", "[]", "0 entries"),
        ("[0.01, 0.004]", "0.01", "a list of"),
        ("[0.01, 0.004]", "[0]", "above 0"),
        ("[0.01, 0.004]", "[1.5]", "at most 1"),
        ("[0.01, 0.004]", "[nan]", "above 0"),
        ("[0.01, 0.004]", "[true]", "above 0"),
        ("[0.01, 0.004]", "[0.0040000001]", "six digits"),
        ("[0.01, 0.004]", "[0.01, 0.010]", "twice"),
        ("rates = [0.01, 0.004]\n", "", "no rates for scene one"),
        ("seeds = [0, 7]\n", "", "has no seeds"),
        ("[0, 7]", "[-1]", "whole numbers from 0"),
        ("[0, 7]", "[9223372036854775808]", "whole numbers from 0"),
        ("[0, 7]", "[1, 1]", "twice"),
        ('baseline = "a"', 'baseline = "c"', "methods of kind train are a, b"),
        ('baseline = "a"', 'baseline = "whole"', "methods of kind train are a, b"),
        ('name = "two"', 'name = "../two"', "name is"),
        ('name = "two"', 'name = ".."', "name is"),
        ('name = "two"', 'name = ".two"', "name is"),
        ('name = "two"', 'name = "two."', "name is"),
        ('name = "two"', 'name = "a/b"', "name is"),
        ('name = "two"', f'name = "{"a" * 65}"', "name is"),
        ('name = "two"', "name = 2", "name is 2"),
        ('name = "two"', 'name = "two\\n"', "name is"),
        ('name = "two"', 'name = "ONE"', "two scenes are named ONE"),
        ('name = "b"', 'name = "a"', "two methods are named a"),
        ('photographs = "one"', "", "has no photographs"),
        ('photographs = "one"', 'photographs = "a\\u0000"', "a folder is required"),
        ("size = 40", 'size = "wide"', "WIDTHxHEIGHT"),
        ("size = 40", "size = -1", "WIDTHxHEIGHT"),
        ("size = 40", 'background = "grey"', "white, black or R,G,B"),
        ("size = 40", "background = 1", "white, black or R,G,B"),
        ("size = 40", "holdout = -1", "a whole number of 0 or more"),
        ("size = 40", "voxel = 0", "a number above 0"),
        ("size = 40", "voxel = inf", "a number above 0"),
        ("size = 40", "anchors = 0", "a whole number of 1 or more"),
        ("size = 40", "voxel = 1\nanchors = 9", "one of them is enough"),
        ("size = 40", 'set = ["holdout=3"]', "the scene's holdout"),
        ("size = 40", "size = 40\ncolour = 1", "has colour"),
        ("steps = 5", '"x - at `$.y" = 1', "unknown field"),
        ('kind = "uncompressed"', 'kind = "other"', "train or uncompressed"),
        ('kind = "uncompressed"', 'preset = "slow"', "fast or paper"),
        ('scenes = ["two"]', 'scenes = ["three"]', "scenes are one, two"),
        ("masks.epsilon=0.03", "masks.epsilom=0.03", "no setting masks.epsilom"),
        ("masks.epsilon=0.03", "masks.epsilon=2", "0 to 1"),
        ("masks.epsilon=0.03", "masks.epsilon", "not NAME=VALUE"),
        ("masks.epsilon=0.03", "rate.lambda_r=0.1", "use rates instead"),
        ("masks.epsilon=0.03", " seed =1", "use seeds instead"),
        ('["masks.epsilon=0.03"]', "{a = 1}", "a list of"),
        ("[[scenes]]", "[scenes]", "not TOML"),
        ("seeds", "x = [[scenes]]\nseeds", "not TOML"),
        ("seeds", f"x = {'[' * 5000}\nseeds", "not TOML"),
        ("steps = 5", "steps = 5\nx = '\x1b[2J'", "not TOML"),
    ],
)
def test_what_is_wrong_is_said(tmp_path: Path, old: str, new: str, words: str) -> None:
    assert old in TEXT
    with pytest.raises(ExperimentError) as error:
        read(tmp_path, TEXT.replace(old, new, 1))
    text = str(error.value)
    assert words in text
    assert text.startswith(str(tmp_path / "x.toml"))
    assert text.isprintable()


def test_bounds(tmp_path: Path) -> None:
    with pytest.raises(ExperimentError, match="more than 1048576 bytes"):
        read(tmp_path, TEXT + "#" * plan.SIZE_MAX)
    with pytest.raises(ExperimentError, match="1001 entries"):
        read(tmp_path, TEXT.replace("[0, 7]", str([*range(1001)])))
    rates = [i / 1000 for i in range(1, 1001)]
    with pytest.raises(ExperimentError, match="more than 100000 cells"):
        read(tmp_path, TEXT.replace("[0, 7]", str([*range(1000)])).replace("[0.01, 0.004]", str(rates)))
    (tmp_path / "x.toml").write_bytes(b"\xff")
    with pytest.raises(ExperimentError, match="not TOML"):
        read_experiment(tmp_path / "x.toml")


_VALUES: Any = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["name", "set", "x"]), inner),
    max_leaves=5,
)


@given(
    st.dictionaries(st.sampled_from(["scenes", "methods", "rates", "seeds", "steps", "device", "baseline"]), _VALUES)
)
def test_any_document_is_read_or_refused(document: dict[str, Any]) -> None:
    with pytest.raises(ExperimentError):
        plan._experiment(Path("x.toml"), document)


def test_what_a_definition_depends_on(tmp_path: Path) -> None:
    """Settings, photographs and commands; neither the place nor the threads nor the names."""
    one = next(cells(read(tmp_path)))
    first = hash_of(one.definition("photographs"))
    assert hash_of(one.definition("others")) != first
    for old, new in (
        ("steps = 5", "steps = 6"),
        ("size = 40", "size = 41"),
        ('name = "a"', 'name = "a"\nset = ["start.anchors=9"]'),
    ):
        assert hash_of(next(cells(read(tmp_path, TEXT.replace(old, new, 1)))).definition("photographs")) != first
    renamed = TEXT.replace('"a"', '"c"').replace("[0, 7]", "[0]")
    assert hash_of(next(cells(read(tmp_path, renamed))).definition("photographs")) == first


@pytest.mark.parametrize("path", sorted(FILES.iterdir()), ids=lambda path: path.stem)
def test_the_files_of_the_project(path: Path) -> None:
    """The settings of all cells are accepted, and the file's own notes count its training runs."""
    experiment = read_experiment(path)
    count = len(list(cells(experiment)))
    if path.stem != "tiny":
        assert re.search(rf"^# (There are )?{count} training runs", path.read_text(), re.MULTILINE)
    for scene in experiment.scenes:
        if "$" not in scene.photographs:
            assert experiment.photographs(scene).is_dir()


def test_departures_differ_from_the_method_in_what_they_set() -> None:
    """Each method of departures.toml changes what it names, and nothing else."""
    experiment = read_experiment(FILES / "departures.toml")
    (scene,) = experiment.scenes
    pro, *others = (document(experiment.settings(scene, method, 0.004, 0)) for method in experiment.methods)
    for method, other in zip(experiment.methods[1:], others, strict=True):
        changed = [difference.split(" is ")[0] for difference in differences(other, pro)]
        named = sorted(change.partition("=")[0] for change in method.changes)
        assert [name.removesuffix(".averaging") for name in changed] == named, method.name
