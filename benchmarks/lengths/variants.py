"""What an entropy model that is measured consists of. The default is the format's at 12,800 anchors or fewer."""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Group:
    """Columns of one kind that are coded together.

    kind: f, s or o (features, scalings, offsets). start, stop: columns of that kind; stop -1 is the kind's end. reads:
    kinds whose columns of earlier groups a network of the group reads, with m for the masks. Empty: no network.
    """

    kind: str
    start: int
    stop: int
    reads: str = ""


def slices(*widths: int, reads: str = "f") -> tuple[Group, ...]:
    """Features in slices, of which each after the first one reads those before."""
    found, done = [], 0
    for width in widths:
        found.append(Group("f", done, done + width, reads if done else ""))
        done += width
    return tuple(found)


SCALINGS, OFFSETS = Group("s", 0, -1), Group("o", 0, -1)
FORMAT = (*slices(5, 10, 15, 20), SCALINGS, OFFSETS)
# All features at once, without CARM.
ALONE = (*slices(50), SCALINGS, OFFSETS)


@dataclass(frozen=True)
class Variant:
    """An entropy model, and how it is trained.

    channels: of the planes; 0 for no planes. size: B over SPEC B.3's. start: deviation of the planes' first latents.
    sharp: whether they are rounded from the beginning. frequencies: of gamma; 0 for none. hyper: hidden widths of F_h,
    which is its last biases alone without channels, frequencies and neighbours. sarm: hidden widths; None: planes cost
    nothing, as a bound. groups: in coding order. carm: hidden widths of the groups' networks. shared: one hidden layer
    for all groups, of which each reads a part. mixture: whether features have two distributions, as in HAC++.
    neighbours: symbols of anchors decoded before, which F_h reads: of the K nearest ones among all before in Morton
    order (before:K), of the nearest ones of a coarser level (levels:K), or, which no decoder could do, of the nearest
    ones of all (oracle:K). order: of the features by their bits, rising or falling.

    weighed: whether training counts the bits of weights; without, steps are chosen after it. laplace: whether weights
    are under a Laplace distribution.
    """

    channels: int = 8
    size: float = 1.0
    start: float = 0.03
    sharp: bool = False
    frequencies: int = 10
    hyper: tuple[int, ...] = (32,)
    sarm: tuple[int, ...] | None = (16, 16)
    groups: tuple[Group, ...] = FORMAT
    carm: tuple[int, ...] = (32,)
    shared: bool = False
    mixture: bool = False
    neighbours: str = ""
    order: str = ""
    weighed: bool = True
    laplace: bool = False
    steps: int = 1000
    batch: int = 1024

    def fitted(self, widths: tuple[int, ...]) -> Variant | None:
        """The same for a scene of these slices, or None if the groups have other features than the paper and the scene.

        The paper's slices stand for those of the scene, and its 50 features for all of them.
        """
        features = tuple(group for group in self.groups if group.kind == "f")
        for paper, own in ((slices(5, 10, 15, 20), slices(*widths)), (slices(50), slices(sum(widths)))):
            if self.groups[: len(features)] == paper:
                return replace(self, groups=(*own, *self.groups[len(paper) :]))
        return self if max(group.stop for group in features) == sum(widths) else None
