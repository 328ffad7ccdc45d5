"""Settings: docs/method.md has some, each is documented, and they are printed, read and changed with checks."""

import re
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import pytest

from refcodec.api.learning import TrainingWords
from refcodec.cli.main import main
from refcodec.train.schedule import Clock
from refcodec.train.settings import PRESETS, FitSettings, Phase, TrainSettings
from refcodec.train.settings_file import SettingsError, assigned, differences, document, from_toml, to_toml, varied

METHOD = Path(__file__).resolve().parents[2] / "docs" / "method.md"


def setting(name: str) -> Any:
    """The default of a setting, by its dotted name."""
    value: Any = TrainSettings()
    for key in name.split("."):
        if isinstance(value, tuple):
            (value,) = (phase for phase in value if phase.name == key)
        else:
            value = getattr(value, key)
    return value


def test_the_text_has_these_constants() -> None:
    """The table and prose of the method, and the fitter's steps."""
    text = METHOD.read_text()
    section = text.split("## Settings of the method")[1].split("\n## ")[0]
    rows = re.findall(r"^\| (`.+?`(?:, `.+?`)*) \| (.+?) \|", section, re.MULTILINE)
    names = [name for cell, _ in rows for name in re.findall(r"`([\w.]+)`", cell)]
    assert len(names) == len(set(names)) == 21
    assert [f"phases.{phase.name}.begin" in names for phase in TrainSettings().phases] == [False] + 7 * [True]
    for cell, value in rows:
        values = tuple(setting(name) for name in re.findall(r"`([\w.]+)`", cell))
        assert (values if len(values) > 1 else values[0]) == eval(value, {})
    assert setting("rate.plane_period") == 4
    assert "every fourth step" in " ".join(section.split())
    fitted = FitSettings()
    assert fitted.quantisation == TrainSettings().quantisation
    stated = f"an offset step of {fitted.scene.offsets} instead of {fitted.quantisation.offsets}"
    assert stated in " ".join(text.split("## Fits")[1].split())


def documented(group: Any, name: str = "") -> list[str]:
    """The names of all settings; fails where one has no documentation."""
    paths = []
    for entry in fields(group):
        value, path = getattr(group, entry.name), f"{name}{entry.name}"
        if entry.metadata:
            assert entry.metadata["meaning"], path
            assert entry.metadata["source"], path
            paths.append(path)
        elif is_dataclass(value):
            assert type(value).__doc__, path
            paths += documented(value, path + ".")
        else:
            assert path == "phases"
    return paths


@pytest.mark.parametrize("settings", [TrainSettings(), FitSettings()], ids=["train", "fit"])
def test_every_setting_has_a_meaning_and_a_source(settings: Any) -> None:
    assert len(documented(settings)) > 15


@pytest.mark.parametrize("preset", PRESETS)
def test_what_is_printed_reads_back(preset: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["train", "--preset", preset, "--print-settings"]) == 0
    printed = capsys.readouterr().out
    (tmp_path / "settings.toml").write_text(printed)
    assert from_toml(tmp_path / "settings.toml", TrainSettings(steps=1)) == PRESETS[preset]
    assert to_toml(PRESETS[preset]) == printed
    assert all(name.rsplit(".", 1)[-1] in printed for name in documented(TrainSettings()))
    assert varied(TrainSettings(), document(PRESETS[preset])) == PRESETS[preset]
    assert f" {preset}: {PRESETS[preset].steps:,} steps," in " ".join(str(TrainingWords.__doc__).split())


def test_one_comes_after_the_other(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The preset, the file, --set, and the options of their own."""
    (tmp_path / "settings.toml").write_text("steps = 7\nseed = 5\n[growth]\nperiod = 11\n[rate]\nlambda_r = 0.01\n")
    words = ["--preset", "paper", "--settings", str(tmp_path / "settings.toml"), "--set", "growth.period=12"]
    assert main(["train", *words, "--set", "steps=8", "--lambda", "0.02", "--print-settings"]) == 0
    (tmp_path / "printed.toml").write_text(capsys.readouterr().out)
    changes = {"steps": 8, "seed": 5, "growth.period": 12, "rate.lambda_r": 0.02}
    assert from_toml(tmp_path / "printed.toml", TrainSettings()) == varied(PRESETS["paper"], changes)


@pytest.mark.parametrize(
    ("assignment", "difference"),
    [
        ("growth.gradient=1e-4", "growth.gradient is 0.0001, not 0.0002"),
        ("growth.gradient=1", "growth.gradient is 1.0, not 0.0002"),
        ("sampling.among=visible", "sampling.among is visible, not all"),
        ("size=400x300", "size is 400x300, not 400"),
        ("growth.edges=[8, 1]", "growth.edges is [8, 1], not [4, 2, 1]"),
        ("masks.used=false", "masks.used is False, not True"),
        ("learning.features.start=0.02", "learning.features.start is 0.02, not 0.01"),
        ("learning.masks={end = 1e-4}", "learning.masks.end is 0.0001, not 0.01"),
        ("phases.rate.begin=0.33", "phases.rate.begin is 0.33, not 0.4"),
        ("phases.weights.modes.weights=float", "phases.weights.modes.weights is float, not grid"),
    ],
)
def test_changes(assignment: str, difference: str) -> None:
    changed = assigned(TrainSettings(), [assignment])
    assert list(differences(document(changed), document(TrainSettings()))) == [difference]


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("speed=1", "there is no setting speed; there are steps, "),
        ("growth.speed=1", "there is no setting growth.speed; growth has period, "),
        ("growth=1", "growth is a group: set one of period, "),
        ("growth.period=1.5", "growth.period is 1.5: an integer is required"),
        ("growth.period=0", "growth.period is 0: an integer >= 1 is required"),
        ("growth.gradient=steep", "growth.gradient is 'steep': a number is required"),
        ("growth.gradient=nan", "growth.gradient is 'nan': a number is required"),
        ("loss.ssim=2", "loss.ssim is 2: a number <= 1.0 is required"),
        ("masks.used=1", "masks.used is 1: true or false is required"),
        ("sampling.among=none", "sampling.among is 'none': one of all, visible is required"),
        ("growth.edges=4", "growth.edges is 4: a list is required"),
        ("growth.edges=[]", "growth.edges is []: a list of length >= 1 is required"),
        ("growth.edges=[4, 0]", "growth.edges[1] is 0: an integer >= 1 is required"),
        ("weights.coarser=[1]", "weights.coarser is [1]: a list of length 2 is required"),
        (
            "entropy.slices=[1, 1]",
            "entropy.slices has 2 features, but must have 3, which begin as an anchor's colour, to 128",
        ),
        ("weights.coarser=[3, 1]", "weights.coarser is 3 to 1: nothing is left to try"),
        ("phases=1", "phases is 1: a list is required"),
        ("phases=[{name = 'a', begin = 0}]", "phases[0].modes is missing"),
        ("phases.rate.end=1", "phases.rate.end is not known"),
        ("phases.last.begin=1", "there is no phase last; phases are start, growth, "),
        ("phases.rate=1", "phases.rate is 1: a table of name, begin, modes is required"),
        ("phases.rate.name=masks", "two phases have the same name"),
        ("phases.rate.begin=soon", "phases.rate.begin is 'soon': a number is required"),
        ("phases.rate.begin=0.1", "phases begin at [0.0, 0.03, 0.25, 0.1, "),
        ("phases.weights.begin=1", "shares from 0 to less than 1 in ascending order are required"),
        ("phases.rate.modes.rate=fast", "phases.rate has rate = 'fast'; parts and their modes are masks: off or "),
        ("phases.rate.modes.speed=on", "phases.rate has speed = 'on'; parts and their modes are "),
        ("phases.rate.modes.growth=grow", "phases.rate has growth = 'grow': anchors cannot change under a rate"),
        ("growth.period", "'growth.period' is not NAME=VALUE"),
    ],
)
def test_wrong_changes(assignment: str, message: str, refused: Callable[..., str]) -> None:
    with pytest.raises(SettingsError, match=re.escape(message)):
        assigned(TrainSettings(), [assignment])
    assert message in refused("train", "--set", assignment, "--print-settings")


def test_wrong_files(tmp_path: Path, refused: Callable[..., str]) -> None:
    file = tmp_path / "settings.toml"
    assert "No such file" in refused("train", "--settings", file, "--print-settings")
    for content, message in ((b"steps = ", "not TOML"), (b"\xff", "not UTF-8"), (b"speed = 1", "setting speed")):
        file.write_bytes(content)
        refusal = refused("train", "--settings", file, "--print-settings")
        assert str(file) in refusal
        assert message in refusal


def test_phases_say_what_parts_do() -> None:
    phases = (Phase("a", 0.0, {"masks": "on"}), Phase("b", 0.5, {"rate": "on"}), Phase("c", 0.75, {"masks": "off"}))
    clock = Clock(phases, 8)
    modes = []
    for done in range(9):
        clock.done = done
        modes.append((clock.mode("masks"), clock.mode("rate"), clock.mode("growth"), clock.since("rate")))
    assert modes[3] == ("on", "off", "off", 0.0)
    assert modes[4] == ("on", "on", "off", 0.0)
    assert modes[6] == ("off", "on", "off", 0.5)
    assert modes[8] == ("off", "on", "off", 1.0)
    assert clock.mode("masks", 5) == "on"
