"""Clauses 7.1 and 10.1: the order in which a file is decoded and checked."""

from .attributes import read_attributes
from .chunks import entries_start, read_entries
from .context import ContextSource
from .dimensions import weight_count
from .directory import read_directory
from .frame import read_frame
from .header import ATTRIBUTES, CHUNK_TABLE, FRAME, MASKS, PLANES, POSITIONS, WEIGHTS, read_header, read_prologue
from .masks import read_mask_model, read_masks
from .planes import join_quadrants, read_planes
from .positions import read_position_model, read_positions
from .scene import Chunk, Scene
from .tables import load_tables
from .trace import Trace
from .weights import read_weights


# SPEC 2.1, 7.1, 10.1
def decode(data: bytes, trace: Trace | None = None) -> Scene:
    """Return the scene of a file. Raises C3GSError if the file is refused.

    trace: gets the symbols of a group when the group is decoded.
    """
    tables = load_tables()
    header = read_header(data, read_prologue(data))
    sections = read_directory(data, header, weight_count(header))
    frame = read_frame(data, sections[FRAME])
    weights = read_weights(data, header, sections[WEIGHTS], tables, trace)
    planes = read_planes(data, header, sections[PLANES], weights.networks["sarm"], tables.laplace, trace)
    table = sections[CHUNK_TABLE].offset
    mask_model = read_mask_model(data, header, table)
    model_at = table + 2 * len(mask_model)
    position_model = read_position_model(data, model_at) if header.position_mode else None
    spans = [(sections[n].offset, sections[n].length) for n in (POSITIONS, MASKS, ATTRIBUTES)]
    parts = read_entries(data, header, table + entries_start(header), spans)
    positions = [read_positions(data, header, n, part[0], position_model, trace) for n, part in enumerate(parts)]
    masks = [read_masks(data, header, n, part[1], mask_model, trace) for n, part in enumerate(parts)]
    context = ContextSource(
        frame, [planes[0], join_quadrants(planes[1:])], weights.plane_shift, header["frequency_count"], tables.sine
    )
    chunks = []
    for number, (part, chunk_positions, chunk_masks) in enumerate(zip(parts, positions, masks)):
        part[2].check(data)
        contexts = [context(position) for position in chunk_positions]
        symbols, steps = read_attributes(
            data, header, number, part[2], weights, tables.gauss, contexts, chunk_masks, trace
        )
        chunks.append(Chunk(chunk_positions, chunk_masks, symbols, steps))
    return Scene(header, frame, weights, planes, mask_model, chunks)
