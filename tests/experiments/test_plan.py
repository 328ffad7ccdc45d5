"""An experiment's file is read strictly, and its cells match the file."""

import re
from pathlib import Path

import pytest

from refcodec.experiments.cells import cells, hash_of
from refcodec.experiments.plan import Experiment, ExperimentError, parse_experiment, read_experiment

FILES = Path(__file__).resolve().parents[2] / "benchmarks" / "experiments"
TEXT = """
lambdas = [0.01, 0.004]
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
holdout = 5
lambdas = [0.5]
set = ["background=white", "start.anchors=700", "masks.epsilon=0.02", "growth.most=99"]
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


def read(text: str = TEXT) -> Experiment:
    return parse_experiment(Path("/x/x.toml"), text.encode())


def test_the_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    """Their names and commands. The settings of a definition are what `refcodec train` makes of the command."""
    experiment = read()
    every = list(cells(experiment))
    names = [cell.name for cell in every]
    assert names == [
        *(f"one/a/lambda-{value}/seed-{seed}" for value in ("0.004", "0.01") for seed in (0, 7)),
        *(f"one/whole/lambda-0/seed-{seed}" for seed in (0, 7)),
        *(f"two/{method}/lambda-0.5/seed-{seed}" for method in "ab" for seed in (0, 7)),
    ]
    assert [cell.name for cell in cells(experiment, ("*/b/*seed-7", "one/whole/*-0"))] == [names[4], names[9]]
    commands = {
        names[0]: [
            "train P -o w/scene --preset fast --lambda 0.004 --seed 0 --size 40 --steps 5",
            "encode w/scene -o w/scene.c3gs",
            "eval w/scene.c3gs P --size 40 --json",
        ],
        names[4]: [
            "train P -o w/scene --preset fast --lambda 0 --seed 0 --size 40 --steps 5",
            "eval w/scene P --size 40 --json",
        ],
        names[8]: [
            "train P -o w/scene --preset fast --lambda 0.5 --seed 0 --size 400 --holdout 5 --steps 5"
            " --set background=white --set start.anchors=700 --set masks.epsilon=0.02 --set growth.most=99"
            " --set masks.epsilon=0.03",
            "encode w/scene -o w/scene.c3gs",
            "eval w/scene.c3gs P --size 400 --holdout 5 --json",
        ],
    }
    for cell in every:
        if cell.name in commands:
            steps = cell.steps_of(Path("w"), Path("P"), 3)
            assert [" ".join(step.words) for step in steps] == commands[cell.name]
            assert steps[0].free == ("--threads", "3", "--progress")
    settings = every[8].settings
    assert (settings.background, settings.holdout, settings.start.anchors) == ("white", 5, 700)
    # What a method sets is set after what the scene sets.
    assert (settings.masks.epsilon, settings.growth.most, settings.rate.lambda_r) == (0.03, 99, 0.5)
    one, two = experiment.scenes
    assert experiment.photographs(one) == Path("/x/one")
    monkeypatch.delenv("SOMEWHERE", raising=False)
    with pytest.raises(ExperimentError, match="set the variable SOMEWHERE"):
        experiment.photographs(two)
    monkeypatch.setenv("SOMEWHERE", "/data")
    assert experiment.photographs(two) == Path("/data/two")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("lambdas = [0.01", "rates = [0.01", "rates is now named lambdas"),
        ("steps = 5", "stops = 5", "stops is not known; `refcodec experiment --help` has the keys"),
        ("steps = 5", "steps = 0", "steps is 0: an integer >= 1 is required"),
        ("steps = 5", 'device = "tpu"', "'tpu'"),
        ("[0.01, 0.004]", "[nan]", "finite"),
        ("[0.01, 0.004]", "[0.0040000001]", "six digits"),
        ("[0.01, 0.004]", "[0.01, 0.010]", "twice"),
        ("lambdas = [0.01, 0.004]\n", "", "no lambdas for scene one"),
        ("[0, 7]", "[1, 1]", "twice"),
        ("[0, 7]", str([*range(1001)]), "length <= 1000"),
        ("[0, 7]", f"{[*range(1000)]}\n#", "more than 100000 cells"),
        ('baseline = "a"', 'baseline = "whole"', "methods of kind train are a, b"),
        ('name = "two"', 'name = "../two"', "the name '../two' is not 1 to 64 letters"),
        ('name = "two"', 'name = "ONE"', "the names of scenes has 'one' twice"),
        ('photographs = "one"', 'photographs = "a\\u0000"', "photographs"),
        ("size = 40", 'size = "wide"', "WIDTHxHEIGHT"),
        ("size = 40", 'set = ["holdout=3"]', "the scene's holdout"),
        ('scenes = ["two"]', 'scenes = ["three"]', "scenes are one, two"),
        ("masks.epsilon=0.03", "masks.epsilom=0.03", "no setting masks.epsilom"),
        ("masks.epsilon=0.03", "rate.lambda_r=0.1", "use lambdas instead"),
        ("[[scenes]]", "[scenes]", "not TOML"),
        ("seeds", f"x = {'[' * 5000}\nseeds", "nested deeper"),
        ("steps = 5", "steps = 5\nx = '\x1b[2J'", "not TOML"),
    ],
)
def test_a_wrong_file_is_refused(old: str, new: str, words: str) -> None:
    assert old in TEXT
    text = TEXT.replace(old, new, 1)
    if "cells" in words:
        text = text.replace("[0.01, 0.004]", str([i / 1000 for i in range(1, 1001)]))
    with pytest.raises(ExperimentError) as error:
        read(text)
    assert words in str(error.value)
    assert str(error.value).startswith("/x/x.toml: ")
    assert str(error.value).isprintable()


def test_a_definition_depends_on_settings_photographs_and_commands() -> None:
    """Neither on the place of files nor on names."""

    def first(text: str, photographs: str = "x") -> str:
        return hash_of(next(cells(read(text))).definition(photographs))

    assert first(TEXT, "y") != first(TEXT)
    changes = {"steps = 5": "steps = 6", "size = 40": "size = 41", "[[methods]]": "[[methods]]\nstatic = true"}
    for old, new in changes.items():
        assert first(TEXT.replace(old, new, 1)) != first(TEXT)
    assert first(TEXT.replace('"a"', '"c"').replace("[0, 7]", "[0]")) == first(TEXT)


@pytest.mark.parametrize("path", sorted(FILES.iterdir()), ids=lambda path: path.stem)
def test_the_files_of_the_project(path: Path) -> None:
    """The settings of all cells are accepted, and the file's own notes count its training runs."""
    experiment = read_experiment(path)
    count = len(list(cells(experiment)))
    assert path.stem == "tiny" or re.search(rf"^# {count} training runs", path.read_text(), re.MULTILINE)
    for scene in experiment.scenes:
        assert "$" in scene.photographs or experiment.photographs(scene).is_dir()
