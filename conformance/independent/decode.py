"""Clauses 7.1 and 10.1: a whole file, in the order of checks."""

from dataclasses import dataclass

from .attributes import read_attributes
from .container import FRAME, PLANES, WEIGHTS, Header, read_chunk_table, read_directory, read_header, read_prologue
from .geometry import ContextSource, Frame, read_frame
from .masks import read_masks
from .networks import Weights, read_weights, weight_count
from .planes import Plane, join_quadrants, read_planes
from .positions import read_positions
from .tables import load_tables
from .trace import Trace


@dataclass(frozen=True)
class Chunk:
    """The decoded anchors of a chunk; an item for each anchor in each list."""

    positions: list[tuple[int, int, int]]
    masks: list[list[int]]
    symbols: list[list[int]]
    steps: list[list[int]]


@dataclass(frozen=True)
class Scene:
    """What a file says."""

    header: Header
    frame: Frame
    weights: Weights
    planes: list[Plane]
    mask_model: list[int]
    chunks: list[Chunk]


# SPEC 2.1, 7.1, 10.1
def decode(data: bytes, trace: Trace | None = None) -> Scene:
    """The scene of a file; C3GSError for a file that is refused. The trace gets each symbol once its group is decoded."""
    tables = load_tables()
    header = read_header(data, read_prologue(data))
    sections = read_directory(data, header, weight_count(header))
    frame = read_frame(data, sections[FRAME])
    weights = read_weights(data, header, sections[WEIGHTS], tables, trace)
    planes = read_planes(data, header, sections[PLANES], weights.networks["sarm"], tables.laplace, trace)
    mask_model, position_model, parts = read_chunk_table(data, header, sections)
    positions = [read_positions(data, header, n, part[0], position_model, trace) for n, part in enumerate(parts)]
    masks = [read_masks(data, header, n, part[1], mask_model, trace) for n, part in enumerate(parts)]
    context = ContextSource(frame, [planes[0], join_quadrants(planes[1:])], weights.plane_shift, header["frequency_count"], tables.sine)
    chunks = []
    for number, (part, chunk_positions, chunk_masks) in enumerate(zip(parts, positions, masks)):
        part[2].check(data)
        contexts = [context(position) for position in chunk_positions]
        symbols, steps = read_attributes(data, header, number, part[2], weights, tables.gauss, contexts, chunk_masks, trace)
        chunks.append(Chunk(chunk_positions, chunk_masks, symbols, steps))
    return Scene(header, frame, weights, planes, mask_model, chunks)
