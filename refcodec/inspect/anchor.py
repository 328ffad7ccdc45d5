"""The numbers of one anchor, from its position to its symbols."""

from collections.abc import Iterable, Iterator

from ..bitstream.codec import Coding
from ..bitstream.scene import Scene
from .probes import geometry, predictions, slices


def anchor_rows(scene: Scene, number: int) -> Iterator[tuple[str, str, str]]:
    """Yields the quantities that clauses 7.4 to 7.10 compute for an anchor.

    They lead from the position to the distributions and the symbols. Each is (description, clause, numbers). Raises
    IndexError for an anchor that the scene does not have.
    """
    if not 0 <= number < scene.anchor_count:
        raise IndexError(number)

    def row(what: str, clause: str, values: Iterable[object]) -> tuple[str, str, str]:
        return what, clause, ", ".join(str(value) for value in values)

    at = slice(number, number + 1)
    for q in geometry(scene, at):
        yield row(q.what, q.clause, q.values[0])
    coding = Coding(scene)
    given = predictions(scene, coding, at)
    for q in given:
        yield row(q.what, q.clause, q.values[0])
    yield row("scalings: symbols", "7.10", scene.attributes.scalings[number])
    kept = zip(scene.masks[number], scene.attributes.offsets[number].tolist(), strict=True)
    yield row("offsets: symbols", "7.10", (tuple(offset) if mask else "masked" for mask, offset in kept))
    features, done = scene.attributes.features[number], 0
    for i, (mean, scale) in enumerate(slices(scene, coding, at, given[0].values, given[1].values)):
        columns = mean.values.shape[1]
        yield row(mean.what, mean.clause, zip(mean.values[0].tolist(), scale.values[0].tolist(), strict=True))
        yield row(f"slice {i}: symbols", "7.10", features[done : done + columns])
        done += columns
    yield row("step indices of features, scalings, offsets", "7.8", scene.attributes.steps[number])
