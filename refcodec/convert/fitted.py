"""An uncompressed scene, such as one of a model, with an entropy model."""

from pathlib import Path

from ..bitstream.batches import Progress
from ..bitstream.scene import Scene
from ..statuses import refusing
from ..train.fit import fit
from ..train.fit_input import read_given
from ..train.settings import FitSettings
from ..train.settings_file import varied
from .networks import on_grids


def fitted_scene(folder: Path, lambda_r: float | None, steps: int | None, progress: Progress) -> tuple[Scene, str]:
    """Returns the coded scene of an uncompressed scene's folder, and a message if Ctrl-C ended the training early.

    lambda_r, steps: of the fit, None for the defaults. Raises UsageError.
    """
    changes = {"lambda_r": lambda_r, "steps": steps}
    settings = varied(FitSettings(), {name: value for name, value in changes.items() if value is not None})
    with refusing(f"{folder} cannot be fitted"):
        given = read_given(folder)
        result = fit(given, settings, progress=progress)
        scene, done = on_grids(result.scene, given.cloud), result.report["steps"]
    if done == settings.steps or not scene.anchor_count:
        return scene, ""
    return scene, f"stopped at step {done} of {settings.steps}; the file is written, but larger than necessary"
