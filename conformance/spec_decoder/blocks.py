"""The Python blocks of SPEC.md: a decoder from the bytes of a file to its digests or its error.

`python -m spec` made this file from SPEC.md. Do not edit it.
"""
# mypy: ignore-errors
# ruff: noqa
# fmt: off

import math

from .support import ascii_bytes as ASCII
from .support import sha256 as SHA256
from .support import table_bytes

# SPEC 2.5
MAJOR = 0
MINOR = 0
HEADER_LENGTH_MIN = 4
HEADER_LENGTH_MAX = 65532
SECTION_LENGTH_MAX = 2**48
ANCHORS_OF_A_BYTE = 16
FEATURES_MAX = 128
LANES_LOG2_MAX = 8
BASE_STEP_MIN = 2**-60
BASE_STEP_MAX = 2**60
ORIGIN_BOUND = 2**62
SCALE_EXPONENT_MAX = 60
MATRIX_BOUND = 2**20
TRANSLATION_BOUND = 2**61
FRAME_SHIFT_MAX = 60
FRAME_RANGE_BOUND = 2**18
PLANE_SHIFT_MAX = 10
CARM_SHIFT_MAX = 16
WEIGHT_SYMBOL_MAX = 2**24 - 1
WEIGHT_EXPONENT_MIN = -104
WEIGHT_EXPONENT_MAX = 149
PLANE_SYMBOL_MAX = 2**15 - 1
ATTRIBUTE_SYMBOL_MAX = 2**23 - 1
CELL_LEVELS = 16
CELL_INDEX = 40
POSITION_MODELS = 18
ACTIVATION_MAX = 1023
WEIGHT_MAX = 1023
ACCUMULATOR_BOUND = 2**24
EXPONENT_MAX = 20
UNIT_BITS = 16
FRAME_CLAMP = 2**30 - 1
LERP_BITS = 8
STATE_MIN = 2**16
PRECISION = 14
RAW_MAX = 16
ESCAPE_PREFIX_MAX = 23
SCALE_MIN = -40
SCALE_END = 24
FRACTIONS = 16
SINE_LENGTH = 1024
STEP_LENGTH = 64
STEP_SHIFT = 12
OUTPUT_BITS = 12
SCALING_BITS = 16
SCALING_BOUND = 27 * 2**16
LOG2_E = 1549082005

# SPEC 10.3
ERRORS = {
    "prologue.truncated": (101, "malformed", "6.1", "the file is shorter than a prologue"),
    "prologue.signature": (102, "malformed", "6.1", "the first eight bytes are not the signature"),
    "prologue.crc": (103, "malformed", "6.1", "the prologue's CRC-32 does not match"),
    "prologue.version": (104, "unsupported", "6.1", "the major version is not MAJOR"),
    "prologue.header_length": (105, "malformed", "6.1", "header_length is outside its limits or not a multiple of 4"),
    "header.truncated": (201, "malformed", "6.2", "the file ends inside the header"),
    "header.crc": (202, "malformed", "6.2", "the header's CRC-32 does not match"),
    "header.syntax": (203, "malformed", "6.2", "the header's fields do not fill header_length exactly"),
    "header.reserved": (204, "unsupported", "6.2", "a reserved field is not zero"),
    "header.profile": (205, "unsupported", "11.1", "the profile is not known"),
    "header.level": (206, "unsupported", "11.2", "the level is not known in this profile"),
    "header.dimension": (207, "invalid", "11.1", "a dimension is outside the bounds of the profile"),
    "header.anchor_count": (208, "invalid", "11.2", "anchor_count exceeds the level's limit"),
    "header.level_not_minimal": (209, "invalid", "11.2", "a lower level would hold this scene"),
    "header.chunk_size": (210, "invalid", "11.1", "chunk_size is outside its limits"),
    "header.lanes": (211, "invalid", "6.2", "a lane count is outside its limits"),
    "header.base_step": (212, "invalid", "6.2", "a base step is outside its limits"),
    "header.position_grid": (213, "invalid", "6.4", "a field of the position grid is outside its limits"),
    "header.render_info": (214, "invalid", "6.5", "a field of the render information is outside its limits"),
    "header.work": (215, "invalid", "11.2", "the work exceeds the level's limit"),
    "header.padding": (216, "malformed", "6.2", "the padding of the dimensions is not zero"),
    "header.chunk_count": (217, "invalid", "6.2", "chunk_count does not fit anchor_count and chunk_size"),
    "directory.type": (301, "malformed", "6.6", "a section's type is not four letters"),
    "directory.unknown_critical": (302, "unsupported", "6.6", "a critical section has an unknown type"),
    "directory.order": (303, "malformed", "6.6", "a critical section is missing, repeated or out of order"),
    "directory.mode": (304, "unsupported", "6.6", "the coding mode of a section is not known"),
    "directory.length": (305, "malformed", "6.6", "a section's length is too large or not the one that the header implies"),
    "section.truncated": (311, "malformed", "6.6", "the file ends inside a section"),
    "section.crc": (312, "malformed", "6.6", "a section's CRC-32 does not match, or the crc of DATA is not 0"),
    "section.padding": (313, "malformed", "6.6", "the padding after a section is not zero"),
    "file.trailing": (321, "malformed", "6.6", "bytes follow the last section"),
    "frame.range": (401, "invalid", "6.7", "a number of the PCA frame is outside its limits"),
    "frame.reserved": (402, "unsupported", "6.7", "a reserved field is not zero"),
    "weights.scale": (411, "invalid", "6.8", "a field of WeightScales is outside its limits"),
    "weights.not_finite": (412, "invalid", "6.8", "a weight or bias is NaN or infinite"),
    "weights.bound": (413, "invalid", "6.8", "a row's integers could reach the accumulator bound"),
    "weights.length": (414, "malformed", "6.8", "the LayerModels and raw values do not fit the section"),
    "weights.layer": (415, "invalid", "6.8", "a field of a LayerModel is outside its limits"),
    "weights.exponent": (416, "invalid", "6.8", "a row's grid exponent is not the one that its values imply"),
    "weights.padding": (417, "malformed", "6.8", "the padding of WeightScales is not zero"),
    "weights.reserved": (418, "unsupported", "6.8", "a reserved field is not zero"),
    "planes.length": (421, "malformed", "6.9", "the substreams' lengths do not add up to the section"),
    "planes.padding": (422, "malformed", "6.9", "the padding after a substream is not zero"),
    "index.mask_model": (431, "invalid", "6.10", "a frequency of the mask model is outside its limits"),
    "index.position_model": (432, "invalid", "6.10", "a number of the PositionModel is outside its limits"),
    "index.chunk": (433, "invalid", "6.10", "a field of a ChunkEntry is outside its limits"),
    "index.length": (434, "malformed", "6.10", "the anchors or bytes of the chunks do not add up"),
    "index.padding": (435, "malformed", "6.10", "the padding of the mask model is not zero"),
    "index.reserved": (436, "unsupported", "6.10", "a reserved field is not zero"),
    "chunk.crc": (441, "malformed", "6.11", "a chunk's CRC-32 does not match"),
    "chunk.length": (442, "malformed", "6.11", "the parts of a chunk do not fill it exactly"),
    "chunk.form": (443, "malformed", "6.11", "the form of a chunk's positions is not known"),
    "chunk.padding": (444, "malformed", "6.11", "the padding after a part of a chunk is not zero"),
    "chunk.reserved": (445, "unsupported", "6.11", "a reserved field is not zero"),
    "chunk.kept": (446, "invalid", "6.11", "kept_count is not the number of kept offsets"),
    "chunk.bounds": (447, "invalid", "6.11", "low and high are not the bounds of the chunk's positions"),
    "positions.not_finite": (451, "invalid", "6.11", "a position is NaN or infinite"),
    "positions.negative_zero": (452, "invalid", "6.11", "a position is -0"),
    "positions.count": (453, "invalid", "6.11", "the tree does not have as many cells as the chunk has anchors"),
    "positions.cell": (454, "invalid", "6.11", "a cell represents no finite f16"),
    "substream.length": (501, "malformed", "8.1", "the substream is shorter than its states and words"),
    "substream.state": (502, "invalid", "8.1", "an initial state is below STATE_MIN"),
    "substream.words": (503, "invalid", "8.8", "the symbols do not consume exactly word_count words"),
    "substream.final_state": (504, "invalid", "8.8", "a final state is not STATE_MIN"),
    "substream.escape": (505, "invalid", "8.7", "an escape's prefix is too long"),
    "substream.symbol_range": (506, "invalid", "8.5", "a symbol exceeds the limit of its kind"),
    "substream.raw_length": (507, "invalid", "8.8", "the raw bits do not fill the substream's raw bytes exactly"),
    "substream.raw_padding": (508, "invalid", "8.8", "an unused bit of the last raw byte is not zero"),
    "substream.symbol_crc": (509, "invalid", "8.8", "the CRC-32 of the decoded symbols does not match"),
}

# SPEC 11.1
BOUNDS = [
    [
        ("offset_count", 1, 10),
        ("plane_channels", 0, 8),
        ("frequency_count", 0, 10),
        ("slice_count", 1, 4),
        ("hyper_layers", 0, 2),
        ("sarm_layers", 1, 2),
        ("carm_layers", 0, 2),
        ("view_inputs", 0, 8),
        ("colour_outputs", 1, 48),
        ("plane_size", 2, 32),
        ("render_width", 1, 64),
        ("hyper_width", 1, 64),
        ("sarm_width", 1, 16),
        ("carm_width", 1, 64),
        ("slice_width", 1, 16),
        ("chunk_size", 1, 65536),
    ],
    [
        ("offset_count", 1, 16),
        ("plane_channels", 0, 16),
        ("frequency_count", 0, 16),
        ("slice_count", 1, 16),
        ("hyper_layers", 0, 2),
        ("sarm_layers", 1, 2),
        ("carm_layers", 0, 2),
        ("view_inputs", 0, 8),
        ("colour_outputs", 1, 48),
        ("plane_size", 2, 1024),
        ("render_width", 1, 128),
        ("hyper_width", 1, 128),
        ("sarm_width", 1, 32),
        ("carm_width", 1, 128),
        ("slice_width", 1, 64),
        ("chunk_size", 256, 16384),
    ],
]

# SPEC 11.2
LEVELS = [
    {"profile": 0, "level": 0, "anchor_count": 4096, "plane_size": 32, "work": 2**28},
    {"profile": 1, "level": 1, "anchor_count": 131072, "plane_size": 128, "work": 2**33},
    {"profile": 1, "level": 2, "anchor_count": 1048576, "plane_size": 256, "work": 2**36},
    {"profile": 1, "level": 3, "anchor_count": 4194304, "plane_size": 256, "work": 2**38},
    {"profile": 1, "level": 4, "anchor_count": 16777216, "plane_size": 512, "work": 2**41},
    {"profile": 1, "level": 5, "anchor_count": 67108864, "plane_size": 1024, "work": 2**43},
]

# SPEC 2.4
def RSHIFT_ROUND(a, s):
    """floor(a / 2^s + 1/2), for s >= 0."""
    return (a + ((1 << s) >> 1)) >> s


# SPEC 2.4
def CLAMP(a, low, high):
    return min(max(a, low), high)


# SPEC 2.4
def BIT_LENGTH(a):
    """The least n with a < 2^n, for a >= 0."""
    n = 0
    while a >> n:
        n += 1
    return n


# SPEC 2.4
def ISQRT(a):
    """The largest integer r with r * r <= a."""
    r = 0
    for bit in range(BIT_LENGTH(a) // 2, -1, -1):
        if (r | 1 << bit) * (r | 1 << bit) <= a:
            r = r | 1 << bit
    return r


# SPEC 2.4
def U(data, at, size):
    """The unsigned integer of so many bytes at a place of data."""
    return sum([data[at + i] << 8 * i for i in range(size)])


# SPEC 2.4
def I(data, at, size):
    """The signed integer of so many bytes at a place of data."""
    value = U(data, at, size)
    return value - (1 << 8 * size) if value >> (8 * size - 1) else value


# SPEC 2.4
def IS_FINITE(bits):
    """Whether an f32 is neither infinite nor NaN."""
    return bits >> 23 & 255 != 255


# SPEC 2.4
def SIGNIFICAND(bits):
    """(m, e) of a finite f32, which is m * 2^e."""
    exponent, fraction = bits >> 23 & 255, bits & 0x7FFFFF
    m, e = (fraction | 1 << 23, exponent - 150) if exponent else (fraction, -149)
    return (-m if bits >> 31 else m), e


# SPEC 2.4
def ROUND_SCALED(bits, e):
    """floor(x * 2^e + 1/2), for x a finite f32."""
    m, own = SIGNIFICAND(bits)
    return m << (own + e) if own + e >= 0 else RSHIFT_ROUND(m, -own - e)


# SPEC 2.4
def ROUND_F32(n, e):
    """The f32 nearest to n * 2^e, ties to the even significand. The limits of this document keep it finite; 0 is +0."""
    if n == 0:
        return 0
    m, sign = (-n, 1 << 31) if n < 0 else (n, 0)
    s = max(BIT_LENGTH(m) - 24, -149 - e)
    if s > 0:
        rest = m & ((1 << s) - 1)
        m = m >> s
        if rest > 1 << (s - 1) or (rest == 1 << (s - 1) and m % 2):
            m += 1
    else:
        m = m << -s
    if m == 1 << 24:
        m, s = m >> 1, s + 1
    return sign | m + ((e + s + 149) << 23)


# SPEC 7.2
def DERIVE_ROW(weights, bias):
    """(integer weights, integer bias, exponent) of one row, or None if there is no exponent."""
    for e in range(EXPONENT_MAX, -1, -1):
        w = [ROUND_SCALED(x, e) for x in weights]
        b = ROUND_SCALED(bias, e)
        largest = max([abs(x) for x in w] + [0])
        worst = sum([abs(x) for x in w]) * ACTIVATION_MAX + abs(b) + ((1 << e) >> 1)
        if largest <= WEIGHT_MAX and worst < ACCUMULATOR_BOUND:
            return w, b, e
    return None


# SPEC 7.2
def ACTIVATION(a):
    return CLAMP(a, -ACTIVATION_MAX, ACTIVATION_MAX)


# SPEC 7.2
def NETWORK(layers, inputs):
    """The outputs of a network. layers: for each layer the rows from DERIVE_ROW; inputs: activations."""
    for number, rows in enumerate(layers):
        out = []
        for w, b, e in rows:
            t = RSHIFT_ROUND(sum([x * a for x, a in zip(w, inputs)]) + b, e)
            out.append(t if number == len(layers) - 1 else CLAMP(t, 0, ACTIVATION_MAX))
        inputs = out
    return inputs


# SPEC 7.3
def PLANE_GROUPS(channels, size):
    """The points (channel, i, j) of each wavefront, in coding order."""
    groups = []
    for t in range(3 * size - 2):
        rows = [i for i in range(size) if 0 <= t - 2 * i < size]
        groups.append([(k, i, t - 2 * i) for k in range(channels) for i in rows])
    return groups


# SPEC 7.3
def DECODE_PLANE(stream, sarm, channels, size):
    """One sub-plane, as plane[channel][i][j]."""
    plane = [[[0] * size for _ in range(size)] for _ in range(channels)]

    def at(k, i, j):
        return plane[k][i][j] if 0 <= i < size and 0 <= j < size else 0

    for group in PLANE_GROUPS(channels, size):
        parameters = []
        for k, i, j in group:
            near = [at(k, i - 1, j - 1), at(k, i - 1, j), at(k, i - 1, j + 1), at(k, i, j - 1)]
            parameters.append(NETWORK(sarm, [ACTIVATION(y) for y in near]))
        for (k, i, j), y in zip(group, DECODE_VALUES(stream, LAPLACE, parameters, PLANE_SYMBOL_MAX)):
            plane[k][i][j] = y
    return plane


# SPEC 7.3
def JOIN_QUADRANTS(quadrants):
    """The plane of r = 2 from its four sub-planes."""
    joined = []
    for a, b, c, d in zip(quadrants[0], quadrants[1], quadrants[2], quadrants[3]):
        joined.append([x + y for x, y in zip(a, b)] + [x + y for x, y in zip(c, d)])
    return joined


# SPEC 7.4
def POSITION_INTEGER(bits):
    """P of the f16 with these 16 bits."""
    exponent, mantissa = (bits >> 10) & 31, bits & 1023
    p = mantissa if exponent == 0 else (mantissa + 1024) << (exponent - 1)
    return -p if bits >> 15 else p


# SPEC 7.5.5
def FRAME_COORDINATES(frame, p):
    v = []
    for r in range(3):
        t = sum([a * x for a, x in zip(frame["matrix"][3 * r : 3 * r + 3], p)]) + frame["translation"][r]
        v.append(CLAMP(RSHIFT_ROUND(t, frame["shift"][r]), -FRAME_CLAMP, FRAME_CLAMP))
    return v


# SPEC 7.5.5
def CONTRACT(v):
    unit = 1 << UNIT_BITS
    q = sum([x * x for x in v])
    if q <= unit * unit:
        return v
    n = ISQRT(q)
    f = ((2 * n - unit) * unit) // n
    return [(x * f) // n for x in v]


# SPEC 7.5.5
def RESCALE(frame, w):
    return [
        CLAMP(((x - a) << UNIT_BITS) // (b - a), 0, 1 << UNIT_BITS) for x, a, b in zip(w, frame["low"], frame["high"])
    ]


# SPEC 7.5.5
def QUERY(plane, u, plane_shift):
    """Samples of all channels of plane[channel][i][j] at u = (u_0, u_1)."""
    size = len(plane[0])
    cell, weight = [], []
    for x in u:
        g = x * (size - 1)
        c = min(g >> UNIT_BITS, size - 2)
        cell.append(c)
        weight.append(RSHIFT_ROUND(g - (c << UNIT_BITS), UNIT_BITS - LERP_BITS))
    (j, i), (fj, fi), one = cell, weight, 1 << LERP_BITS
    out = []
    for y in plane:
        t = y[i][j] * (one - fj) * (one - fi) + y[i][j + 1] * fj * (one - fi)
        t += y[i + 1][j] * (one - fj) * fi + y[i + 1][j + 1] * fj * fi
        out.append(ACTIVATION(RSHIFT_ROUND(t, 2 * LERP_BITS - plane_shift)))
    return out


# SPEC 7.5.5
def GAMMA(u, frequencies):
    out = []
    for k in range(frequencies):
        phase = ((u - (1 << (UNIT_BITS - 1))) << k) % (1 << UNIT_BITS)
        turn = RSHIFT_ROUND(phase * SINE_LENGTH, UNIT_BITS)
        out += [SINE[turn % SINE_LENGTH], SINE[(turn + SINE_LENGTH // 4) % SINE_LENGTH]]
    return out


# SPEC 7.5.5
def CONTEXT(frame, planes, plane_shift, frequencies, position_bits):
    """planes: the five sub-planes, or none; frame: None if there are no planes and no frequencies."""
    if frame is None:
        return []
    u = RESCALE(frame, CONTRACT(FRAME_COORDINATES(frame, [POSITION_INTEGER(b) for b in position_bits])))
    samples = []
    if planes:
        samples = QUERY(planes[0], u[:2], plane_shift) + QUERY(JOIN_QUADRANTS(planes[1:]), u[:2], plane_shift)
    return samples + GAMMA(u[2], frequencies)


# SPEC 7.6
def DECODE_MASKS(stream, mask_model, offset_count, anchors):
    """The K bits of each anchor."""
    masks = [[] for _ in range(anchors)]
    for k in range(offset_count):
        models = []
        for m in masks:
            f = mask_model[k * (k + 1) // 2 + sum(m)]
            models.append([(1 << PRECISION) - f, f])
        bits = DECODE_GROUP(stream, models)
        NOTE_SYMBOLS(stream, bits)
        for m, bit in zip(masks, bits):
            m.append(bit)
    return masks


# SPEC 7.10, 7.7, 7.8, 7.9
def DECODE_ATTRIBUTES(stream, networks, carm_shift, slices, contexts, masks):
    """The D symbols and three step indices of each anchor. networks: by name; the name of carm.i is the number i."""
    anchors = range(len(contexts))
    features = sum(slices)
    total = features + 6 + 3 * len(masks[0])
    hyper = [NETWORK(networks["hyper"], c) for c in contexts]
    symbols = [[0] * total for _ in anchors]

    def group(channels, change):
        wanted, parameters = [], []
        for n in anchors:
            for c in channels:
                if c < features + 6 or masks[n][(c - features - 6) // 3]:
                    dm, ds = change[n][c - channels[0]] if change else (0, 0)
                    wanted.append((n, c))
                    parameters.append((hyper[n][c] + dm, hyper[n][total + c] + ds))
        for (n, c), y in zip(wanted, DECODE_VALUES(stream, GAUSS, parameters, ATTRIBUTE_SYMBOL_MAX)):
            symbols[n][c] = y

    group(range(features, features + 6), None)
    group(range(features + 6, total), None)
    first = 0
    for i, width in enumerate(slices):
        change = None
        if i:
            change = []
            for n in anchors:
                inputs = [ACTIVATION(RSHIFT_ROUND(symbols[n][c], carm_shift[c])) for c in range(first)]
                out = NETWORK(networks[i], inputs)
                change.append([(out[c], out[width + c]) for c in range(width)])
        group(range(first, first + width), change)
        first += width
    steps = [[CLAMP(x, 0, STEP_LENGTH - 1) for x in h[2 * total :]] for h in hyper]
    return symbols, steps


# SPEC 7.12
def CELL_NUMBER(c, cell_shift):
    """The 16 bits of the f16 that a cell coordinate represents, or None."""
    n = c - (1 << (CELL_LEVELS - 1))
    bits = abs(n)
    if cell_shift < CELL_INDEX:
        p = abs(n) << cell_shift
        e = max(BIT_LENGTH(p) - 11, 0)
        if p & ((1 << e) - 1):
            return None
        bits = (e << 10) + (p >> e)
    if bits >= 0x7C00:
        return None
    return bits | 0x8000 if n < 0 else bits


# SPEC 7.12
def DECODE_CELLS(stream, models, anchors):
    """The cells of a packed chunk, and whether their number is that of its anchors."""
    nodes, whole = [(0, 0, 0)], True
    for level in range(CELL_LEVELS - 1, -1, -1):
        first = 6 * min(level, 2)
        low = DECODE_GROUP(stream, [models[first]] * len(nodes))
        NOTE_SYMBOLS(stream, low)
        high = DECODE_GROUP(stream, [models[first + 1 + sum([a >> i & 1 for i in range(4)])] for a in low])
        NOTE_SYMBOLS(stream, high)
        children = []
        for (x, y, z), a, b in zip(nodes, low, high):
            here = a | b << 4
            children += [(2 * x + (k & 1), 2 * y + (k >> 1 & 1), 2 * z + (k >> 2)) for k in range(8) if here >> k & 1]
        whole = whole and len(children) <= anchors
        nodes = children[:anchors]
    return nodes, whole and len(nodes) == anchors


# SPEC 7.12
def DECODE_POSITIONS(part, form, cell_shift, models, anchors, lanes):
    """The positions of a chunk, three f16 for each anchor, and the error name of the first failed check, or None.

    part: the bytes of the positions, with a correct length or substream head.
    """
    if form == 0:
        u = [part[at] | part[at + 1] << 8 for at in range(0, len(part), 2)]
        return [u[3 * n : 3 * n + 3] for n in range(anchors)], None
    stream = OPEN(part, lanes)
    cells, whole = DECODE_CELLS(stream, models, anchors)
    verdict = END(stream)
    positions = [[CELL_NUMBER(c, cell_shift) for c in cell] for cell in cells]
    if verdict is None and not whole:
        verdict = "positions.count"
    if verdict is None and any([None in p for p in positions]):
        verdict = "positions.cell"
    return positions, verdict


# SPEC 7.13
def PACKED_LAYER(exponent, differences, rows, biases):
    """(rows, biases) as f32 from integers, or None if an exponent is wrong."""
    e, first, out = exponent, True, ([], [])
    for difference, row, bias in zip(differences, rows, biases):
        e += difference
        odd = any([n % 2 for n in row + [bias]])
        zero = not any(row + [bias])
        if not WEIGHT_EXPONENT_MIN <= e <= WEIGHT_EXPONENT_MAX or not (odd or zero) or (difference and (zero or first)):
            return None
        first = first and zero
        out[0].append([ROUND_F32(n, -e) for n in row])
        out[1].append(ROUND_F32(bias, -e))
    return None if first and exponent else out


# SPEC 7.13
def DECODE_WEIGHTS(stream, shapes, layers, raw):
    """(rows, biases) of each layer, or None for a layer with a wrong exponent.

    shapes: (outputs, inputs) of each layer; layers: the LayerModels; raw: (rows, biases) of each raw layer.
    """
    parameters = []
    for (rows, _), m in zip(shapes, layers):
        if m["form"]:
            parameters += [(0, SCALE_MIN + m["exponent_scale"])] * rows + [(0, SCALE_MIN + m["bias_scale"])] * rows
    few = DECODE_VALUES(stream, LAPLACE, parameters, WEIGHT_SYMBOL_MAX)
    parameters = []
    for (rows, inputs), m in zip(shapes, layers):
        if m["form"]:
            parameters += [(0, SCALE_MIN + m["weight_scale"])] * (rows * inputs)
    many = DECODE_VALUES(stream, GAUSS, parameters, WEIGHT_SYMBOL_MAX)
    out = []
    for (rows, inputs), m, values in zip(shapes, layers, raw):
        if m["form"]:
            differences, biases, few = few[:rows], few[rows : 2 * rows], few[2 * rows :]
            integers, many = [many[r * inputs : (r + 1) * inputs] for r in range(rows)], many[rows * inputs :]
            values = PACKED_LAYER(m["exponent"], differences, integers, biases)
        out.append(values)
    return out


# SPEC 8.3
def OPEN(data, lanes):
    """The record of a substream that the functions of this chapter use."""
    count = U(data, 4, 4)
    words_at = 8 + 4 * lanes
    raw_at = words_at + 2 * count
    return {
        "symbol_crc": U(data, 0, 4),
        "state": [U(data, 8 + 4 * n, 4) for n in range(lanes)],
        "words": [U(data, words_at + 2 * n, 2) for n in range(count)],
        "raw": data[raw_at:],
        "word_at": 0,
        "raw_at": 0,
        "bad_escape": False,
        "bad_range": False,
        "symbols": [],
    }


# SPEC 8.3, 8.2
def DECODE_SYMBOL(stream, lane, frequencies):
    x = stream["state"][lane]
    slot = x & ((1 << PRECISION) - 1)
    low = symbol = 0
    while slot >= low + frequencies[symbol]:
        low += frequencies[symbol]
        symbol += 1
    x = frequencies[symbol] * (x >> PRECISION) + slot - low
    if x < STATE_MIN:
        at = stream["word_at"]
        word = stream["words"][at] if at < len(stream["words"]) else 0
        stream["word_at"] = at + 1
        x = (x << 16) | word
    stream["state"][lane] = x
    return symbol


# SPEC 8.3
def DECODE_GROUP(stream, models):
    lanes = len(stream["state"])
    return [DECODE_SYMBOL(stream, i % lanes, m) for i, m in enumerate(models)]


# SPEC 8.5
def SELECT(mean, scale):
    """(row, column, centre, number of raw bits)."""
    k = CLAMP(((scale - SCALE_END) >> 3) + 1, 0, RAW_MAX)
    row = CLAMP(scale - 8 * k, SCALE_MIN, SCALE_END - 1)
    h = RSHIFT_ROUND(mean - 8 * ((1 << k) - 1), k) + 8
    return row, h % FRACTIONS, h // FRACTIONS, k


# SPEC 8.7
def READ_BITS(stream, k):
    value = 0
    for i in range(k):
        at = stream["raw_at"]
        if at < 8 * len(stream["raw"]):
            value |= ((stream["raw"][at >> 3] >> (at & 7)) & 1) << i
        stream["raw_at"] = at + 1
    return value


# SPEC 8.7
def READ_ESCAPE(stream, radius):
    """The distance from the centre."""
    negative = READ_BITS(stream, 1)
    z = 0
    while z <= ESCAPE_PREFIX_MAX and not READ_BITS(stream, 1):
        z += 1
    if z > ESCAPE_PREFIX_MAX:
        stream["bad_escape"] = True
        n = 1
    else:
        n = (1 << z) + READ_BITS(stream, z)
    return -(radius + n) if negative else radius + n


# SPEC 8.7, 8.6
def DECODE_VALUES(stream, family, parameters, limit):
    """The symbols of a group with means. parameters: (mean, scale index) of each symbol."""
    chosen = [SELECT(m, s) for m, s in parameters]
    models = [family[row][column] for row, column, _, _ in chosen]
    symbols = DECODE_GROUP(stream, models)
    raw = [READ_BITS(stream, k) for _, _, _, k in chosen]
    values = []
    for (_, _, centre, k), model, j, low in zip(chosen, models, symbols, raw):
        radius = len(model) // 2 - 1
        distance = j - radius if j <= 2 * radius else READ_ESCAPE(stream, radius)
        value = ((centre + distance) << k) + low
        if abs(value) > limit:
            stream["bad_range"] = True
            value = 0
        values.append(value)
    NOTE_SYMBOLS(stream, values)
    return values


# SPEC 8.8
def CRC32(data):
    """The CRC-32 of bytes (2.3)."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc = CRC_TABLE[(crc ^ byte) & 255] ^ crc >> 8
    return crc ^ 0xFFFFFFFF


# SPEC 8.8
def CRC_ENTRY(n):
    for _ in range(8):
        n = n >> 1 ^ 0xEDB88320 if n & 1 else n >> 1
    return n


CRC_TABLE = [CRC_ENTRY(n) for n in range(256)]


# SPEC 8.8
def BYTES(value, size):
    """The bytes of an integer in a file."""
    return [value >> 8 * i & 255 for i in range(size)]


# SPEC 8.8
def NOTE_SYMBOLS(stream, values):
    stream["symbols"] += values


# SPEC 8.8
def END(stream):
    """The error name of the first failed check, or None."""
    if stream["word_at"] != len(stream["words"]):
        return "substream.words"
    if any([x != STATE_MIN for x in stream["state"]]):
        return "substream.final_state"
    if stream["bad_escape"]:
        return "substream.escape"
    if stream["bad_range"]:
        return "substream.symbol_range"
    if len(stream["raw"]) != (stream["raw_at"] + 7) // 8:
        return "substream.raw_length"
    if stream["raw_at"] % 8 and stream["raw"][-1] >> (stream["raw_at"] % 8):
        return "substream.raw_padding"
    if CRC32([byte for v in stream["symbols"] for byte in BYTES(v, 4)]) != stream["symbol_crc"]:
        return "substream.symbol_crc"
    return None


# SPEC 9.2, 9.1
def WORLD(grid, axis, p):
    return ROUND_F32(grid["origin"][axis] + grid["scale_mantissa"] * p, grid["scale_exponent"] - 24)


# SPEC 9.2
def STEP_VALUE(step_index, base_step):
    m, e = SIGNIFICAND(base_step)
    return ROUND_F32(STEP[step_index] * m, e - STEP_SHIFT)


# SPEC 9.2
def VALUE(symbol, step):
    m, e = SIGNIFICAND(step)
    return ROUND_F32(symbol * m, e)


EXP2 = [1073741824, 744260848, 257945537, 59571654, 10398739, 1330132, 234908]


# SPEC 9.4
def EXPONENTIAL(t):
    """(m, n): exp(t / 2^SCALING_BITS) is nearly m * 2^n, with m from 2^30 to 2^31 - 1."""
    y = t * LOG2_E
    fraction = (y & ((1 << 46) - 1)) >> 16
    m = EXP2[6]
    for i in range(5, -1, -1):
        m = EXP2[i] + (m * fraction >> 30)
    return m, (y >> 46) - 30


# SPEC 9.4
def ADD_F32(a, b):
    """The f32 nearest to the sum of two finite f32."""
    (m, e), (n, d) = SIGNIFICAND(a), SIGNIFICAND(b)
    low = min(e, d)
    return ROUND_F32((m << (e - low)) + (n << (d - low)), low)


# SPEC 9.4
def SPLAT(networks, position, feature, scaling, offsets, mask):
    """The Gaussians of one anchor, as f32 one after the other. networks: the rows of each, by name."""
    inputs = [ACTIVATION(ROUND_SCALED(x, 0)) for x in feature]
    opacity, covariance, colour = [NETWORK(networks[name], inputs) for name in RENDERING]
    s = [CLAMP(ROUND_SCALED(x, SCALING_BITS), -SCALING_BOUND, SCALING_BOUND) for x in scaling]
    harmonics, found = len(colour) // len(mask), []
    for k, kept in enumerate(mask):
        if kept:
            for i in range(3):
                (m, e), (own, d) = EXPONENTIAL(s[i]), SIGNIFICAND(offsets[3 * k + i])
                found.append(ADD_F32(position[i], ROUND_F32(own * m, d + e)))
            for i in range(3):
                c = covariance[7 * k + i] << (SCALING_BITS - OUTPUT_BITS)
                found.append(ROUND_F32(s[3 + i] + c, -SCALING_BITS))
            quaternion = covariance[7 * k + 3 : 7 * k + 7]
            if not any(quaternion):
                quaternion = [1 << OUTPUT_BITS, 0, 0, 0]
            for x in quaternion + [opacity[k]] + colour[harmonics * k : harmonics * (k + 1)]:
                found.append(ROUND_F32(x, -OUTPUT_BITS))
    return found


# SPEC 14.3
def RENDER_NETWORK(layers, values):
    """layers: (rows, biases) of each."""
    for number, (rows, biases) in enumerate(layers):
        values = [sum(w * x for w, x in zip(row, values)) + b for row, b in zip(rows, biases)]
        if number < len(layers) - 1:
            values = [max(x, 0.0) for x in values]
    return values


# SPEC 14.3
def NORMALISED(vector, instead):
    length = math.sqrt(sum(x * x for x in vector))
    return [x / length for x in vector] if length > 0 else instead


# SPEC 14.3
def LOGISTIC(x):
    return 1 / (1 + math.exp(-x)) if x > -700 else 0.0


# SPEC 14.3
def GAUSSIANS(networks, position, feature, scaling, offsets, mask, centre, distance_unit):
    """Of one anchor, by increasing offset: (mean, axis lengths, quaternion, opacity, colour).

    offsets: a list of three numbers for each offset; centre: that of the camera, in the world.
    """
    away = [a - b for a, b in zip(position, centre)]
    inputs = list(feature) + NORMALISED(away, [0.0] * 3) + [math.sqrt(sum(x * x for x in away)) / distance_unit]
    opacity, covariance, colour = (RENDER_NETWORK(networks[n], inputs) for n in ("opacity", "covariance", "colour"))
    found = []
    for k, kept in enumerate(mask):
        if kept and math.tanh(opacity[k]) > 0:
            mean = [p + o * math.exp(s) for p, o, s in zip(position, offsets[k], scaling[:3])]
            c = covariance[7 * k : 7 * k + 7]
            lengths = [math.exp(s) * LOGISTIC(x) for s, x in zip(scaling[3:], c[:3])]
            quaternion = NORMALISED(c[3:], [1.0, 0.0, 0.0, 0.0])
            found.append(
                (mean, lengths, quaternion, math.tanh(opacity[k]), [LOGISTIC(x) for x in colour[3 * k : 3 * k + 3]])
            )
    return found


# SPEC 14.4
def ROTATION(quaternion):
    w, x, y, z = quaternion
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]


# SPEC 14.4
def PRODUCT(a, b):
    return [[sum(x * y for x, y in zip(row, column)) for column in zip(*b)] for row in a]


# SPEC 14.4
def PROJECT(mean, lengths, quaternion, camera, near_plane, low_pass):
    """(u, v, depth, inverse covariance (a, b, c)) in the image, or None."""
    x, y, z = (sum(r * p for r, p in zip(row, mean)) + t for row, t in zip(camera["rotation"], camera["translation"]))
    if z <= near_plane:
        return None
    slope = []
    for s, f, c, size in zip((x / z, y / z), camera["focal"], camera["principal_point"], camera["size"]):
        beyond = 0.15 * size / f
        slope.append(min(max(s, -c / f - beyond), (size - c) / f + beyond))
    (fx, fy), (cx, cy) = camera["focal"], camera["principal_point"]
    derivative = [[fx / z, 0.0, -fx * slope[0] / z], [0.0, fy / z, -fy * slope[1] / z]]
    axes = [[m * s for m, s in zip(row, lengths)] for row in ROTATION(quaternion)]
    half = PRODUCT(PRODUCT(derivative, camera["rotation"]), axes)
    (a, b), (_, c) = PRODUCT(half, [list(row) for row in zip(*half)])
    a, c = a + low_pass, c + low_pass
    d = a * c - b * b
    if d <= 0:
        return None
    return fx * x / z + cx, fy * y / z + cy, z, (c / d, -b / d, a / d)


# SPEC 14.5
def PIXEL(u, v, drawn, background, alpha_max):
    """Colour at a point of the image; drawn: (projection, opacity, colour) by increasing depth."""
    left, out = 1.0, [0.0, 0.0, 0.0]
    for (x, y, _, (a, b, c)), opacity, colour in drawn:
        dx, dy = u - x, v - y
        alpha = min(opacity * math.exp(-(a * dx * dx + 2 * b * dx * dy + c * dy * dy) / 2), alpha_max)
        if alpha < 1 / 255:
            continue
        if left * (1 - alpha) < 1e-4:
            break
        out = [o + left * alpha * x for o, x in zip(out, colour)]
        left *= 1 - alpha
    return [min(o + left * g, 1.0) for o, g in zip(out, background)]


# SPEC 14.6
def HARMONICS(direction, count):
    x, y, z = direction
    values = [
        0.28209479177387814,
        -0.4886025119029199 * y,
        0.4886025119029199 * z,
        -0.4886025119029199 * x,
        1.0925484305920792 * x * y,
        -1.0925484305920792 * y * z,
        0.31539156525252005 * (2 * z * z - x * x - y * y),
        -1.0925484305920792 * x * z,
        0.5462742152960396 * (x * x - y * y),
        -0.5900435899266435 * y * (3 * x * x - y * y),
        2.890611442640554 * x * y * z,
        -0.4570457994644658 * y * (4 * z * z - x * x - y * y),
        0.3731763325901154 * z * (2 * z * z - 3 * x * x - 3 * y * y),
        -0.4570457994644658 * x * (4 * z * z - x * x - y * y),
        1.445305721320277 * z * (x * x - y * y),
        -0.5900435899266435 * x * (x * x - 3 * y * y),
    ]
    return values[:count]


# SPEC 14.6
def STATIC_GAUSSIAN(numbers, centre):
    """(mean, axis lengths, quaternion, opacity, colour) of the numbers of 9.4, for a camera's centre in the world."""
    mean, harmonics = list(numbers[:3]), numbers[11:]
    values = HARMONICS(NORMALISED([a - b for a, b in zip(mean, centre)], [0.0] * 3), len(harmonics) // 3)
    sums = [sum(value * h for value, h in zip(values, harmonics[i::3])) for i in range(3)]
    lengths = [math.exp(x) for x in numbers[3:6]]
    quaternion = NORMALISED(numbers[6:10], [1.0, 0.0, 0.0, 0.0])
    return mean, lengths, quaternion, LOGISTIC(numbers[10]), [max(0.5 + x, 0.0) for x in sums]


# SPEC Annex A
def READ_TABLES(data):
    """(SINE, STEP, GAUSS, LAPLACE); a family has for each row, by its number, the list of its columns."""
    sine = [I(data, 2 * j, 2) for j in range(SINE_LENGTH)]
    step = [U(data, 2 * SINE_LENGTH + 2 * q, 2) for q in range(STEP_LENGTH)]
    at = 2 * (SINE_LENGTH + STEP_LENGTH)
    families = []
    for _ in range(2):
        family = {}
        for row in range(SCALE_MIN, SCALE_END):
            family[row] = []
            for _ in range(FRACTIONS):
                count = 2 * data[at] + 2
                family[row].append([U(data, at + 1 + 2 * j, 2) for j in range(count)])
                at += 1 + 2 * count
        families.append(family)
    return sine, step, families[0], families[1]


# SPEC Annex H
class Refused(Exception):
    pass


# SPEC Annex H
def REFUSE(name, offset):
    raise Refused(name, offset)


# SPEC Annex H
def REQUIRE(condition, name, offset):
    if not condition:
        REFUSE(name, offset)


SIGNATURE = [0x89, 0x43, 0x33, 0x47, 0x53, 0x0D, 0x0A, 0x1A]


# SPEC Annex H
def PAD4(n):
    return (n + 3) // 4 * 4


# SPEC Annex H
def PARSE_PROLOGUE(data):
    """header_length and minor."""
    REQUIRE(len(data) >= 20, "prologue.truncated", len(data))
    REQUIRE(data[:8] == SIGNATURE, "prologue.signature", 0)
    REQUIRE(U(data, 16, 4) == CRC32(data[:16]), "prologue.crc", 16)
    REQUIRE(U(data, 8, 2) == MAJOR, "prologue.version", 8)
    length = U(data, 12, 4)
    right = HEADER_LENGTH_MIN <= length <= HEADER_LENGTH_MAX and length % 4 == 0
    REQUIRE(right, "prologue.header_length", 12)
    return length, U(data, 10, 2)


# SPEC Annex H
def TAKE(reader, name, size, count, signed):
    """Reads the next header field, a list of `count` items, and notes its place under the same name."""
    at = reader["at"]
    REQUIRE(at + size * count <= reader["end"], "header.syntax", reader["end"] + 4)
    reader["at"] = at + size * count
    places = [at + size * i for i in range(count)]
    reader["value"][name] = [I(reader["data"], x, size) if signed else U(reader["data"], x, size) for x in places]
    reader["place"][name] = at
    reader["size"][name] = size


# SPEC Annex H
def PARSE_HEADER(data, length, minor):
    """The header fields, each as a list of items, and their places."""
    REQUIRE(len(data) >= 20 + length, "header.truncated", len(data))
    crc_at = 16 + length
    REQUIRE(U(data, crc_at, 4) == CRC32(data[20:crc_at]), "header.crc", crc_at)
    reader = {"data": data, "at": 20, "end": crc_at, "value": {}, "place": {}, "size": {}}
    value, place = reader["value"], reader["place"]
    for name, size, count, signed in FIRST_FIELDS:
        TAKE(reader, name, size, count, signed)
    for name, size, counter in LISTS:
        TAKE(reader, name, size, value[counter][0], False)
    TAKE(reader, "padding", 1, PAD4(reader["at"]) - reader["at"], False)
    entries = []
    for n in range(value["section_count"][0]):
        at = reader["at"]
        TAKE(reader, "entry", 1, 20, False)
        entry = {"at": at, "type": data[at : at + 4], "mode": data[at + 4], "length": U(data, at + 8, 8)}
        entries.append(entry)
    extra = reader["end"] - reader["at"]
    REQUIRE(extra == 0 or minor > MINOR, "header.syntax", reader["at"])
    REQUIRE(not any(value["padding"]), "header.padding", place["padding"])
    for name in ("reserved", "grid_reserved", "render_reserved", "dimensions_reserved"):
        REQUIRE(value[name][0] == 0, "header.reserved", place[name])
    for entry in entries:
        REQUIRE(not any(data[entry["at"] + 5 : entry["at"] + 8]), "header.reserved", entry["at"] + 5)
    return {"value": value, "place": place, "size": reader["size"], "entries": entries}


FIRST_FIELDS = [
    ("profile", 1, 1, False),
    ("level", 1, 1, False),
    ("section_count", 2, 1, False),
    ("anchor_count", 4, 1, False),
    ("chunk_count", 4, 1, False),
    ("chunk_size", 4, 1, False),
    ("plane_lanes_log2", 1, 1, False),
    ("mask_lanes_log2", 1, 1, False),
    ("attribute_lanes_log2", 1, 1, False),
    ("reserved", 1, 1, False),
    ("base_step", 4, 3, False),
    ("origin", 8, 3, True),
    ("scale_mantissa", 2, 1, False),
    ("scale_exponent", 1, 1, True),
    ("grid_reserved", 1, 1, False),
    ("background", 1, 3, False),
    ("up_axis", 1, 1, False),
    ("near_plane", 4, 1, False),
    ("distance_unit", 4, 1, False),
    ("alpha_max", 4, 1, False),
    ("low_pass", 4, 1, False),
    ("colour_primaries", 1, 1, False),
    ("transfer_characteristics", 1, 1, False),
    ("render_model", 1, 1, False),
    ("render_reserved", 1, 1, False),
    ("offset_count", 1, 1, False),
    ("plane_channels", 1, 1, False),
    ("frequency_count", 1, 1, False),
    ("slice_count", 1, 1, False),
    ("hyper_layers", 1, 1, False),
    ("sarm_layers", 1, 1, False),
    ("carm_layers", 1, 1, False),
    ("view_inputs", 1, 1, False),
    ("colour_outputs", 1, 1, False),
    ("dimensions_reserved", 1, 1, False),
    ("plane_size", 2, 1, False),
    ("render_width", 2, 1, False),
]
LISTS = [
    ("hyper_width", 2, "hyper_layers"),
    ("sarm_width", 2, "sarm_layers"),
    ("carm_width", 2, "carm_layers"),
    ("slice_width", 1, "slice_count"),
]


# SPEC Annex H
def SHAPES(v):
    """The name of each network, and (outputs, inputs) of each layer. The name of carm.i is the number i."""
    k, ch, slices = v["offset_count"][0], v["plane_channels"][0], v["slice_width"]
    features = sum(slices)
    d = features + 6 + 3 * k
    nets = [("hyper", [2 * ch + 2 * v["frequency_count"][0]] + v["hyper_width"] + [2 * d + 3])]
    if ch:
        nets.append(("sarm", [4] + v["sarm_width"] + [2]))
    for i in range(1, len(slices)):
        nets.append((i, [sum(slices[:i])] + v["carm_width"] + [2 * slices[i]]))
    for name, outputs in zip(RENDERING, (1, 7, v["colour_outputs"][0])):
        nets.append((name, [features + v["view_inputs"][0], v["render_width"][0], outputs * k]))
    return [(name, [(widths[i + 1], widths[i]) for i in range(len(widths) - 1)]) for name, widths in nets]


RENDERING = ("opacity", "covariance", "colour")
STATIC = 1


# SPEC Annex H
def WEIGHT_COUNT(v, names):
    """The number of weights and biases of the networks with these names."""
    layers = [shape for name, shapes in SHAPES(v) if name in names for shape in shapes]
    return sum([rows * (inputs + 1) for rows, inputs in layers])


# SPEC Annex H
def WORK(v):
    """11.2"""
    d = sum(v["slice_width"]) + 6 + 3 * v["offset_count"][0]
    names = ["hyper"] + [i for i in range(1, v["slice_count"][0])]
    if v["view_inputs"][0] == 0:
        names += RENDERING
    anchor = WEIGHT_COUNT(v, names) + 16 * d
    plane = WEIGHT_COUNT(v, ["sarm"]) + 16
    symbols = 5 * v["plane_channels"][0] * v["plane_size"][0] * v["plane_size"][0]
    return v["anchor_count"][0] * anchor + symbols * plane


# SPEC Annex H
def CHECK_HEADER(h):
    """10.1, FIELDS"""
    v, at = h["value"], h["place"]
    profile, n = v["profile"][0], v["anchor_count"][0]
    REQUIRE(profile < len(BOUNDS), "header.profile", at["profile"])
    levels = [level for level in LEVELS if level["profile"] == profile]
    chosen = [level for level in levels if level["level"] == v["level"][0]]
    REQUIRE(len(chosen) == 1, "header.level", at["level"])
    level = chosen[0]
    for name, low, high in BOUNDS[profile][:-1]:
        for i, item in enumerate(v[name]):
            absent = (item == 0) and (name in ("plane_size", "sarm_layers"))
            REQUIRE(low <= item <= high or absent, "header.dimension", at[name] + h["size"][name] * i)
    ch, size = v["plane_channels"][0], v["plane_size"][0]
    REQUIRE(sum(v["slice_width"]) <= FEATURES_MAX, "header.dimension", at["slice_width"])
    REQUIRE((size == 0) == (ch == 0), "header.dimension", at["plane_size"])
    REQUIRE((v["sarm_layers"][0] == 0) == (ch == 0), "header.dimension", at["sarm_layers"])
    inputs = ch + v["frequency_count"][0]
    REQUIRE(inputs > 0 or v["hyper_layers"][0] == 0, "header.dimension", at["hyper_layers"])
    REQUIRE(v["slice_count"][0] > 1 or v["carm_layers"][0] == 0, "header.dimension", at["carm_layers"])
    if v["render_model"][0] == 0:
        REQUIRE(v["view_inputs"][0] == 4, "header.dimension", at["view_inputs"])
        REQUIRE(v["colour_outputs"][0] == 3, "header.dimension", at["colour_outputs"])
    if v["render_model"][0] == STATIC:
        REQUIRE(v["view_inputs"][0] == 0, "header.dimension", at["view_inputs"])
        REQUIRE(v["colour_outputs"][0] in (3, 12, 27, 48), "header.dimension", at["colour_outputs"])
    REQUIRE(size <= level["plane_size"], "header.dimension", at["plane_size"])
    REQUIRE(n <= level["anchor_count"], "header.anchor_count", at["anchor_count"])
    work = WORK(v)
    for lower in levels:
        held = n <= lower["anchor_count"] and size <= lower["plane_size"] and work <= lower["work"]
        REQUIRE(lower["level"] >= level["level"] or not held, "header.level_not_minimal", at["level"])
    low, high = BOUNDS[profile][-1][1:]
    REQUIRE(low <= v["chunk_size"][0] <= high, "header.chunk_size", at["chunk_size"])
    for name in ("plane_lanes_log2", "mask_lanes_log2", "attribute_lanes_log2"):
        REQUIRE(v[name][0] <= LANES_LOG2_MAX, "header.lanes", at[name])
    for i, step in enumerate(v["base_step"]):
        right = ROUND_F32(1, -60) <= step <= ROUND_F32(1, 60)
        REQUIRE(right, "header.base_step", at["base_step"] + 4 * i)
    for i, origin in enumerate(v["origin"]):
        REQUIRE(-ORIGIN_BOUND < origin < ORIGIN_BOUND, "header.position_grid", at["origin"] + 8 * i)
    REQUIRE(v["scale_mantissa"][0] >= 1, "header.position_grid", at["scale_mantissa"])
    right = -SCALE_EXPONENT_MAX <= v["scale_exponent"][0] <= SCALE_EXPONENT_MAX
    REQUIRE(right, "header.position_grid", at["scale_exponent"])
    REQUIRE(v["up_axis"][0] <= 5, "header.render_info", at["up_axis"])
    one, names = ROUND_F32(1, 0), ("near_plane", "distance_unit", "alpha_max", "low_pass")
    for name in names:
        REQUIRE(IS_FINITE(v[name][0]), "header.render_info", at[name])
    for name in names:
        m, _ = SIGNIFICAND(v[name][0])
        right = m >= 0 if name == "low_pass" else m > 0
        REQUIRE(right and (name != "alpha_max" or v[name][0] <= one), "header.render_info", at[name])
    REQUIRE(work <= level["work"], "header.work", at["anchor_count"])
    c, most = v["chunk_count"][0], v["chunk_size"][0]
    REQUIRE((n + most - 1) // most <= c <= n, "header.chunk_count", at["chunk_count"])


CRITICAL = [ASCII(name) for name in ("FRAM", "WGTS", "PLNS", "INDX", "DATA")]
FRAM, WGTS, PLNS, INDX, DATA = CRITICAL


# SPEC Annex H, 12.1, 13.1
def CHECK_DIRECTORY(h):
    v, entries = h["value"], h["entries"]
    for e in entries:
        letters = all([0x41 <= c <= 0x5A or 0x61 <= c <= 0x7A for c in e["type"]])
        REQUIRE(letters, "directory.type", e["at"])
    for e in entries:
        REQUIRE(e["type"][0] & 32 or e["type"] in CRITICAL, "directory.unknown_critical", e["at"])
    ch, frequencies = v["plane_channels"][0], v["frequency_count"][0]
    wanted = [t for t in CRITICAL if (t != FRAM or ch + frequencies) and (t != PLNS or ch)]
    for e in entries:
        if not e["type"][0] & 32:
            REQUIRE(wanted and wanted[0] == e["type"], "directory.order", e["at"])
            wanted = wanted[1:]
    REQUIRE(not wanted, "directory.order", h["place"]["section_count"])
    for e in entries:
        most = 1 if e["type"] in (WGTS, INDX) else 0
        REQUIRE(e["type"][0] & 32 or e["mode"] <= most, "directory.mode", e["at"] + 4)
    inputs = sum(v["slice_width"][:-1])
    k = v["offset_count"][0]
    for e in entries:
        right = e["length"] <= SECTION_LENGTH_MAX
        if e["type"] == FRAM:
            right = e["length"] == 88
        if e["type"] == WGTS and e["mode"] == 0:
            right = e["length"] == PAD4(2 + inputs) + 4 * WEIGHT_COUNT(v, [name for name, _ in SHAPES(v)])
        if e["type"] == INDX:
            right = e["length"] == PAD4(k * (k + 1)) + 580 * e["mode"] + 28 * v["chunk_count"][0]
        REQUIRE(right, "directory.length", e["at"] + 8)


# SPEC Annex H
def CHECK_SUBSTREAM(data, at, length, lanes):
    """Checks the head and the states of a substream, and returns its bytes."""
    REQUIRE(length >= 8 + 4 * lanes, "substream.length", at)
    REQUIRE(length >= 8 + 4 * lanes + 2 * U(data, at + 4, 4), "substream.length", at)
    REQUIRE(all([U(data, at + 8 + 4 * n, 4) >= STATE_MIN for n in range(lanes)]), "substream.state", at)
    return data[at : at + length]


# SPEC Annex H
def CHECK_END(stream, at):
    verdict = END(stream)
    if verdict is not None:
        REFUSE(verdict, at)


# SPEC Annex H
def PARSE_FRAME(data, at):
    matrix = [I(data, at + 4 * i, 4) for i in range(9)]
    translation = [I(data, at + 36 + 8 * i, 8) for i in range(3)]
    shift = data[at + 60 : at + 63]
    low, high = [[I(data, at + first + 4 * i, 4) for i in range(3)] for first in (64, 76)]
    REQUIRE(data[at + 63] == 0, "frame.reserved", at + 63)
    for i, x in enumerate(matrix):
        REQUIRE(-MATRIX_BOUND < x < MATRIX_BOUND, "frame.range", at + 4 * i)
    for i, x in enumerate(translation):
        REQUIRE(-TRANSLATION_BOUND < x < TRANSLATION_BOUND, "frame.range", at + 36 + 8 * i)
    for i, x in enumerate(shift):
        REQUIRE(x <= FRAME_SHIFT_MAX, "frame.range", at + 60 + i)
    for i in range(3):
        REQUIRE(-FRAME_RANGE_BOUND <= low[i] < FRAME_RANGE_BOUND, "frame.range", at + 64 + 4 * i)
        REQUIRE(low[i] < high[i] <= FRAME_RANGE_BOUND, "frame.range", at + 76 + 4 * i)
    return {"matrix": matrix, "translation": translation, "shift": shift, "low": low, "high": high}


# SPEC Annex H
def PARSE_WEIGHTS(data, at, e, v):
    """plane_shift, carm_shift, the layers of all networks as (rows, biases) in f32, and their integer rows."""
    inputs, end = sum(v["slice_width"][:-1]), at + e["length"]
    values_at = at + PAD4(2 + inputs)
    REQUIRE(values_at <= end, "weights.length", at)
    plane_shift, carm_shift = data[at], data[at + 2 : at + 2 + inputs]
    most = PLANE_SHIFT_MAX if v["plane_channels"][0] else 0
    REQUIRE(plane_shift <= most, "weights.scale", at)
    REQUIRE(data[at + 1] == inputs, "weights.scale", at + 1)
    for i, shift in enumerate(carm_shift):
        REQUIRE(shift <= CARM_SHIFT_MAX, "weights.scale", at + 2 + i)
    REQUIRE(not any(data[at + 2 + inputs : values_at]), "weights.padding", at + 2 + inputs)
    shapes = [(name, shape) for name, layers in SHAPES(v) for shape in layers]
    place, models, raw, places = values_at, [], [], []
    for _, (rows, columns) in shapes:
        model, size = {"form": 0}, 4 * rows * (columns + 1)
        places.append(place)
        if e["mode"]:
            REQUIRE(place + 8 <= end, "weights.length", at)
            model = {
                "form": data[place],
                "exponent_scale": data[place + 1],
                "exponent": I(data, place + 2, 2),
                "weight_scale": data[place + 4],
                "bias_scale": data[place + 5],
            }
            REQUIRE(not any(data[place + 6 : place + 8]), "weights.reserved", place + 6)
            REQUIRE(model["form"] <= 1, "weights.layer", place)
            right = WEIGHT_EXPONENT_MIN <= model["exponent"] <= WEIGHT_EXPONENT_MAX
            REQUIRE(right, "weights.layer", place + 2)
            for name, where in (("exponent_scale", 1), ("exponent", 2), ("weight_scale", 4), ("bias_scale", 5)):
                REQUIRE(model["form"] or model[name] == 0, "weights.layer", place + where)
            place += 8
        values = None
        if not model["form"]:
            REQUIRE(place + size <= end, "weights.length", at)
            found = [U(data, place + 4 * i, 4) for i in range(size // 4)]
            table = [found[r * columns : (r + 1) * columns] for r in range(rows)]
            values = (table, found[rows * columns :])
            place += size
        models.append(model)
        raw.append(values)
    if e["mode"]:
        lanes = 1 << v["attribute_lanes_log2"][0]
        stream = OPEN(CHECK_SUBSTREAM(data, place, end - place, lanes), lanes)
        layers = DECODE_WEIGHTS(stream, [shape for _, shape in shapes], models, raw)
        CHECK_END(stream, place)
    else:
        layers = raw
    for (_, (rows, columns)), model, values, layer_at in zip(shapes, models, layers, places):
        REQUIRE(values is not None, "weights.exponent", layer_at)
        if not model["form"]:
            first = layer_at + (8 if e["mode"] else 0)
            for i, bits in enumerate([x for row in values[0] for x in row] + values[1]):
                REQUIRE(IS_FINITE(bits), "weights.not_finite", first + 4 * i)
    networks, integers = {}, {}
    for name, _ in SHAPES(v):
        networks[name], integers[name] = [], []
    for (name, (_, columns)), values, layer_at in zip(shapes, layers, places):
        networks[name].append(values)
        if name not in RENDERING or v["render_model"][0] == STATIC:
            derived = [DERIVE_ROW(w, b) for w, b in zip(values[0], values[1])]
            for r, row in enumerate(derived):
                # The first weight of the row, or its bias if the layer has no inputs.
                where = layer_at if e["mode"] else layer_at + 4 * r * max(columns, 1)
                REQUIRE(row is not None, "weights.bound", where)
            integers[name].append(derived)
    return {"plane_shift": plane_shift, "carm_shift": carm_shift, "networks": networks, "integers": integers}


# SPEC Annex H
def PARSE_PLANES(data, at, e, v, sarm):
    """The five sub-planes."""
    REQUIRE(e["length"] >= 20, "planes.length", at)
    lengths = [U(data, at + 4 * i, 4) for i in range(5)]
    REQUIRE(e["length"] == 20 + sum([PAD4(n) for n in lengths]), "planes.length", at)
    place, places = at + 20, []
    for n in lengths:
        places.append(place)
        REQUIRE(not any(data[place + n : place + PAD4(n)]), "planes.padding", place + n)
        place += PAD4(n)
    found, lanes = [], 1 << v["plane_lanes_log2"][0]
    for place, n in zip(places, lengths):
        stream = OPEN(CHECK_SUBSTREAM(data, place, n, lanes), lanes)
        found.append(DECODE_PLANE(stream, sarm, v["plane_channels"][0], v["plane_size"][0]))
        CHECK_END(stream, place)
    return found


# SPEC Annex H
def F16_ORDER(bits):
    """An integer that increases with the f16 number."""
    return -(bits & 0x7FFF) if bits >> 15 else bits


# SPEC Annex H
def PARSE_INDEX(data, at, e, v, data_length):
    k, n = v["offset_count"][0], v["anchor_count"][0]
    count = k * (k + 1) // 2
    masks = [U(data, at + 2 * i, 2) for i in range(count)]
    for i, f in enumerate(masks):
        REQUIRE(1 <= f < 1 << PRECISION, "index.mask_model", at + 2 * i)
    place = at + PAD4(2 * count)
    REQUIRE(not any(data[at + 2 * count : place]), "index.padding", at + 2 * count)
    cell_shift, models = None, []
    if e["mode"]:
        cell_shift = data[place]
        REQUIRE(not any(data[place + 1 : place + 4]), "index.reserved", place + 1)
        REQUIRE(cell_shift <= CELL_INDEX, "index.position_model", place)
        for m in range(POSITION_MODELS):
            first = place + 4 + 32 * m
            model = [U(data, first + 2 * i, 2) for i in range(16)]
            REQUIRE(sum(model) == 1 << PRECISION, "index.position_model", first)
            low = [0 if i == 0 and m in (1, 7, 13) else 1 for i in range(16)]
            right = all([f >= x for f, x in zip(model, low)]) and (low[0] or model[0] == 0)
            REQUIRE(right, "index.position_model", first)
            models.append(model)
        place += 580
    entries = []
    for c in range(v["chunk_count"][0]):
        own = place + 28 * c
        entry = {"length": U(data, own, 4), "crc": U(data, own + 4, 4)}
        entry["anchors"], entry["kept"] = U(data, own + 8, 4), U(data, own + 12, 4)
        entry["low"] = [U(data, own + 16 + 2 * i, 2) for i in range(3)]
        entry["high"] = [U(data, own + 22 + 2 * i, 2) for i in range(3)]
        REQUIRE(1 <= entry["anchors"] <= v["chunk_size"][0], "index.chunk", own + 8)
        right = entry["length"] % 4 == 0 and ANCHORS_OF_A_BYTE * (entry["length"] - 16) >= entry["anchors"]
        REQUIRE(right, "index.chunk", own)
        REQUIRE(entry["kept"] <= k * entry["anchors"], "index.chunk", own + 12)
        for i, bits in enumerate(entry["low"] + entry["high"]):
            REQUIRE(bits & 0x7C00 != 0x7C00 and bits != 0x8000, "index.chunk", own + 16 + 2 * i)
        for i in range(3):
            right = F16_ORDER(entry["low"][i]) <= F16_ORDER(entry["high"][i])
            REQUIRE(right, "index.chunk", own + 16 + 2 * i)
        entries.append(entry)
    REQUIRE(sum([x["anchors"] for x in entries]) == n, "index.length", at)
    REQUIRE(sum([x["length"] for x in entries]) == data_length, "index.length", at)
    return {"masks": masks, "cell_shift": cell_shift, "models": models, "entries": entries}


# SPEC Annex H
def DECODE_CHUNK(data, at, entry, v, s):
    """Positions, masks, symbols and step indices of a chunk. s: the decoded sections before DATA."""
    end, n = at + entry["length"], entry["anchors"]
    REQUIRE(end <= len(data), "section.truncated", len(data))
    REQUIRE(CRC32(data[at:end]) == entry["crc"], "chunk.crc", at)
    lengths, form = [U(data, at + 4 * i, 4) for i in range(3)], data[at + 12]
    REQUIRE(not any(data[at + 13 : at + 16]), "chunk.reserved", at + 13)
    REQUIRE(form <= (1 if s["index"]["models"] else 0), "chunk.form", at + 12)
    right = 16 + sum([PAD4(x) for x in lengths]) == entry["length"] and (form or lengths[0] == 6 * n)
    REQUIRE(right, "chunk.length", at)
    place, places = at + 16, []
    for x in lengths:
        places.append(place)
        REQUIRE(not any(data[place + x : place + PAD4(x)]), "chunk.padding", place + x)
        place += PAD4(x)
    lanes = 1 << v["mask_lanes_log2"][0]
    part = data[places[0] : places[0] + lengths[0]]
    if form:
        part = CHECK_SUBSTREAM(data, places[0], lengths[0], lanes)
    positions, verdict = DECODE_POSITIONS(part, form, s["index"]["cell_shift"], s["index"]["models"], n, lanes)
    if verdict is not None:
        REFUSE(verdict, places[0])
    for i, bits in enumerate([bits for p in positions for bits in p]):
        REQUIRE(bits & 0x7C00 != 0x7C00, "positions.not_finite", places[0] + 2 * i)
        REQUIRE(bits != 0x8000, "positions.negative_zero", places[0] + 2 * i)
    for i in range(3):
        column = [F16_ORDER(p[i]) for p in positions]
        right = F16_ORDER(entry["low"][i]) == min(column) and F16_ORDER(entry["high"][i]) == max(column)
        REQUIRE(right, "chunk.bounds", at)
    stream = OPEN(CHECK_SUBSTREAM(data, places[1], lengths[1], lanes), lanes)
    masks = DECODE_MASKS(stream, s["index"]["masks"], v["offset_count"][0], n)
    CHECK_END(stream, places[1])
    REQUIRE(sum([sum(m) for m in masks]) == entry["kept"], "chunk.kept", at)
    lanes = 1 << v["attribute_lanes_log2"][0]
    stream = OPEN(CHECK_SUBSTREAM(data, places[2], lengths[2], lanes), lanes)
    w, frequencies = s["weights"], v["frequency_count"][0]
    contexts = [CONTEXT(s["frame"], s["planes"], w["plane_shift"], frequencies, p) for p in positions]
    symbols, steps = DECODE_ATTRIBUTES(stream, w["integers"], w["carm_shift"], v["slice_width"], contexts, masks)
    CHECK_END(stream, places[2])
    return positions, masks, symbols, steps


# SPEC Annex H
def CHUNK_PARTS(v, networks, positions, masks, symbols, steps):
    """The parts of the canonical reconstruction of some anchors, as bytes, by name. networks: their integer rows."""
    grid = {"origin": v["origin"], "scale_mantissa": v["scale_mantissa"][0], "scale_exponent": v["scale_exponent"][0]}
    features = sum(v["slice_width"])
    parts = {"positions": [], "masks": [], "features": [], "scalings": [], "offsets": []}
    if v["render_model"][0] == STATIC:
        parts["splat"] = []
    table = [[STEP_VALUE(q, base) for q in range(STEP_LENGTH)] for base in v["base_step"]]
    for p, m, y, q in zip(positions, masks, symbols, steps):
        world = [WORLD(grid, axis, POSITION_INTEGER(p[axis])) for axis in range(3)]
        kinds = (y[:features], y[features : features + 6], y[features + 6 :])
        found = [[VALUE(symbol, table[i][q[i]]) for symbol in own] for i, own in enumerate(kinds)]
        parts["masks"] += m
        for name, values in zip(("positions", "features", "scalings", "offsets"), [world] + found):
            for bits in values:
                parts[name] += BYTES(bits, 4)
        if v["render_model"][0] == STATIC:
            for bits in SPLAT(networks, world, found[0], found[1], found[2], m):
                parts["splat"] += BYTES(bits, 4)
    return parts


# SPEC Annex H, 10.1, 15.4
def DECODE_FILE(data):
    """The digests of a file: of its parts, of the scene, and of each chunk."""
    length, minor = PARSE_PROLOGUE(data)
    h = PARSE_HEADER(data, length, minor)
    CHECK_HEADER(h)
    CHECK_DIRECTORY(h)
    v = h["value"]
    s = {"frame": None, "planes": [], "weights": None, "index": None}
    lengths = [e["length"] for e in h["entries"] if e["type"] == DATA]
    names = ("positions", "masks", "planes", "features", "scalings", "offsets", "weights")
    if v["render_model"][0] == STATIC:
        names += ("splat",)
    parts, chunks = {}, []
    for name in names:
        parts[name] = []
    at = 20 + length
    for e in h["entries"]:
        end = at + e["length"]
        if e["type"] == DATA:
            place = at
            for entry in s["index"]["entries"]:
                found = DECODE_CHUNK(data, place, entry, v, s)
                own = CHUNK_PARTS(v, s["weights"]["integers"], found[0], found[1], found[2], found[3])
                head = ASCII("C3GSCHK1") + BYTES(entry["anchors"], 4)
                head += BYTES(v["offset_count"][0], 4) + BYTES(sum(v["slice_width"]), 4)
                chunks.append(SHA256(head + [byte for name in own for byte in own[name]]))
                for name in own:
                    parts[name] += own[name]
                place += entry["length"]
            REQUIRE(U(data, e["at"] + 16, 4) == 0, "section.crc", at)
        else:
            REQUIRE(PAD4(end) <= len(data), "section.truncated", len(data))
            REQUIRE(CRC32(data[at:end]) == U(data, e["at"] + 16, 4), "section.crc", at)
            REQUIRE(not any(data[end : PAD4(end)]), "section.padding", end)
        if e["type"] == FRAM:
            s["frame"] = PARSE_FRAME(data, at)
        if e["type"] == WGTS:
            s["weights"] = PARSE_WEIGHTS(data, at, e, v)
        if e["type"] == PLNS:
            s["planes"] = PARSE_PLANES(data, at, e, v, s["weights"]["integers"]["sarm"])
        if e["type"] == INDX:
            s["index"] = PARSE_INDEX(data, at, e, v, lengths[0])
        at = PAD4(end)
    REQUIRE(len(data) == at, "file.trailing", at)
    parts["planes"] = [byte for plane in s["planes"] for c in plane for row in c for y in row for byte in BYTES(y, 2)]
    for name, _ in SHAPES(v):
        for rows, biases in s["weights"]["networks"][name]:
            for bits in [bits for row in rows for bits in row] + biases:
                parts["weights"] += BYTES(bits, 4)
    digests = [SHA256(parts[name]) for name in names]
    render_info, directory = h["place"]["background"], h["place"]["padding"] + len(v["padding"])
    head = ASCII("C3GSREC1") + BYTES(v["anchor_count"][0], 4) + data[render_info:directory]
    return {"parts": digests, "scene": SHA256(head + [byte for own in digests for byte in own]), "chunks": chunks}


SINE, STEP, GAUSS, LAPLACE = READ_TABLES(table_bytes())
