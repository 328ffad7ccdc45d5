"""Clauses 7.1, 10.1 and 10.4: the order in which a file is decoded and checked."""

from .chunks import ChunkReader
from .context import ContextSource
from .directory import DATA, FRAME, INDEX, PLANES, WEIGHTS, Section, check_section, read_directory
from .errors import require
from .frame import Frame, read_frame
from .header import Header, read_header
from .index import Index, read_index
from .planes import Plane, join_quadrants, read_planes
from .scene import Chunk, Scene
from .tables import load_tables
from .trace import Trace
from .weights import Weights, read_weights


class _Decoder:
    """A file while it is decoded. What follows from a section is there once the section has been read."""

    frame: Frame | None = None
    weights: Weights
    index: Index

    def __init__(self, data: bytes, trace: Trace | None) -> None:
        self._data, self._trace = data, trace
        self.header: Header = read_header(data)
        self._sections = read_directory(self.header)
        self._tables = load_tables()
        self.planes: list[Plane] = []
        self.chunks: list[Chunk] = []

    # SPEC 10.1
    def run(self) -> None:
        """Read the sections in file order."""
        for section in self._sections:
            if section.type != DATA:
                check_section(self._data, section)
            self._read(section)
        end = self._sections[-1].end
        require(len(self._data) == end, "file.trailing", end)

    # SPEC 7.1, 12.1: ancillary sections are skipped
    def _read(self, section: Section) -> None:
        data, header, tables, trace = self._data, self.header, self._tables, self._trace
        if section.type == FRAME:
            self.frame = read_frame(data, section)
        elif section.type == WEIGHTS:
            self.weights = read_weights(data, header, section, tables, trace)
        elif section.type == PLANES:
            sarm = self.weights.networks["sarm"]
            self.planes = read_planes(data, header, section, sarm, tables.laplace, trace)
        elif section.type == INDEX:
            spans = [(other.offset, other.length) for other in self._sections if other.type == DATA]
            self.index = read_index(data, header, section.mode, section.offset, spans[0])
        elif section.type == DATA:
            self._read_chunks(section)

    # SPEC 10.1, [R6.6-7]
    def _read_chunks(self, section: Section) -> None:
        planes = [self.planes[0], join_quadrants(self.planes[1:])] if self.planes else []
        frequencies = self.header["frequency_count"]
        context = ContextSource(self.frame, planes, self.weights.plane_shift, frequencies, self._tables.sine)
        reader = ChunkReader(self._data, self.header, self.index, self.weights, context, self._tables, self._trace)
        for entry in self.index.entries:
            self.chunks.append(reader.read(entry))
        require(section.crc == 0, "section.crc", section.offset)


# SPEC 2.1, 7.1, 10.1, 10.2, 10.4
def decode(data: bytes, trace: Trace | None = None) -> Scene:
    """Return the scene of a file. Raises C3GSError if the file is refused.

    trace: gets the symbols of a group when the group is decoded.
    """
    decoder = _Decoder(data, trace)
    decoder.run()
    d = decoder
    return Scene(d.header, d.frame, d.weights, d.planes, d.chunks)
