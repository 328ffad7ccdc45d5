"""Open files: the header is read at once, the chunks on demand."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from functools import cached_property
from types import TracebackType

from ..bitstream.ancillary import TYPES
from ..bitstream.bounds import CAMERA, CHUNK, Limits
from ..bitstream.cameras import cameras
from ..bitstream.codec import parse
from ..bitstream.directory import INDEX, read_section
from ..bitstream.errors import BitstreamError
from ..bitstream.header import Header, read_header
from ..bitstream.metadata import metadata
from ..bitstream.scene import Ancillary
from ..bitstream.source import FileBytes, Place, Source
from ..bitstream.streaming import DecodedChunk, decoded_chunks
from ..files.text import counted
from ..folder.places import opened_source
from ..formats.splats import Splats
from ..inspect.elements import outline_of
from ..inspect.parts import SPAN_BYTES, part_bytes
from ..pages import notebook
from ..rendering.camera import Camera
from ..rendering.gaussians import check_static
from .scenes import Scene, named_cameras

# The most bytes of an ancillary section of a known type that are read.
_SECTION_BYTES = 1 << 24


class File:
    """A C3GS file that is open for reading. It is a context manager, and shows itself in a notebook.

    From a disk or a URL, only the requested bytes are read. Iteration yields the chunks.

    header: the fields of the header (refcodec.bitstream.header.Header).
    byte_count: the file length.
    """

    header: Header
    byte_count: int

    def __init__(self, source: Source, limits: Limits) -> None:
        """Reads the header. `open` makes one. Raises BitstreamError 101 to 305."""
        self._source, self._limits, self._close = source, limits, contextlib.ExitStack()
        self.header = read_header(source)
        self.byte_count = source.length()

    def __enter__(self) -> File:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Closes the file. Values that were read remain. A file object of the caller stays open."""
        self._close.close()

    @property
    def anchor_count(self) -> int:
        """N, the number of anchors."""
        return self.header.anchor_count

    @property
    def offset_count(self) -> int:
        """K, the offsets of each anchor."""
        return self.header.dimensions.offset_count

    @property
    def chunk_count(self) -> int:
        """The number of chunks."""
        return self.header.chunk_count

    @cached_property
    def sizes(self) -> dict[str, int]:
        """Bytes of each part of the file, with nothing decoded. Their sum is byte_count."""
        index = self.header.section(INDEX)
        heads = min(self.byte_count, SPAN_BYTES)
        # The index is read and parsed.
        self._limits.check_memory(3 * index.length + CHUNK * self.chunk_count + 2 * heads)
        data = FileBytes(self._source)
        return part_bytes(data, outline_of(data))

    @property
    def metadata(self) -> dict[str, str]:
        """SPEC 6.14: the description of the file, such as title, author and licence."""
        return metadata(self._ancillary)

    @property
    def cameras(self) -> list[Camera]:
        """SPEC 6.15: the cameras of the file. The first one is the default view."""
        return named_cameras(cameras(self._ancillary))

    @cached_property
    def _ancillary(self) -> list[Ancillary]:
        kept = []
        shown = [s for s in self.header.sections if s.type in TYPES and s.length <= _SECTION_BYTES]
        self._limits.check_memory((2 + CAMERA) * sum(section.length for section in shown))
        for section in shown:
            # Decoding reports a damaged section. Here it is ignored.
            with contextlib.suppress(BitstreamError):
                kept.append(Ancillary(section.type, section.mode, read_section(self._source, section).data))
        return kept

    def chunks(self, numbers: range | None = None) -> Iterator[DecodedChunk]:
        """SPEC 10.2: yields the chunks in order, decoded, in bounded memory.

        Without `numbers` the whole file is read and checked: the iterator ends only if the file is accepted. With them,
        only the bytes that these chunks need are read.

        Args:
            numbers: the numbers of the chunks, increasing, such as range(3, 5).

        Raises:
            BitstreamError: the file is rejected. The chunks before are correct.
            BoundPassedError: the file exceeds the limits of `open`.
            IndexError: the file lacks some of these chunks.
        """
        # The iterator keeps the file open.
        yield from decoded_chunks(self._source, numbers, limits=self._limits)

    def __iter__(self) -> Iterator[DecodedChunk]:
        return self.chunks()

    def decode(self) -> Scene:
        """Returns the scene of the whole file. Raises BitstreamError and BoundPassedError."""
        return self._decoded()

    def _decoded(self, gaussians: int = 0) -> Scene:
        """As decode. gaussians: copies of a static scene's Gaussians that are held beside it."""
        # A byte behind the end that the header states is enough for the verdict on all of them.
        size = min(self.header.sections[-1].end + 1, self.byte_count)
        self._limits.check(self.header, copies=1, gaussians=gaussians, size=size)
        scene = parse(self._source.read(0, size)).scene
        return Scene(scene, self.sizes)

    def __repr__(self) -> str:
        chunks = counted(self.chunk_count, "chunk")
        return f"<refcodec.File: {self.byte_count:,} bytes, {self.anchor_count:,} anchors in {chunks}>"

    def _repr_html_(self) -> str:
        """Returns the HTML for a notebook: a table of anchors, chunks and bytes by part. Nothing is decoded."""
        facts = [
            ("anchors", f"{self.anchor_count:,}, {self.offset_count} offsets each"),
            ("chunks", f"{self.chunk_count:,}"),
            *self.metadata.items(),
        ]
        return notebook.table("C3GS file", facts, self.sizes)


def open(file: Place, *, limits: Limits | None = None) -> File:
    """Opens a file, and reads and checks its header.

    Args:
        file: a path, a URL (which needs the extra `http` and a server that answers ranges), the bytes of a file, or a
            file object in binary mode. A seekable one is read from its start, on request, and another one at once.
        limits: what the file may use, or None. Set limits for files of unknown origin.

    Raises:
        BitstreamError: the header is rejected.
        BoundPassedError: a pipe, which is read at once, exceeds the limits.
        OSError: the file cannot be read.
        refcodec.statuses.UsageError: the URL cannot be read.
        TypeError: the file is none of these, or a file object in text mode.
    """
    with contextlib.ExitStack() as stack:
        made = File(*stack.enter_context(opened_source(file, limits)))
        made._close = stack.pop_all()
    return made


def splats(file: Place, *, limits: Limits | None = None) -> Splats:
    """SPEC 9.4: returns the Gaussians of a static scene's file, the same bits on every machine. Needs no camera.

    With n Gaussians, `mean` is float32 [n, 3] in world units, `scale` [n, 3] the natural logarithms of the axes'
    lengths, `quaternion` [n, 4] w, x, y, z, `opacity` [n] logits, and `base` [n, 3] and `rest` [n, K, 3] the
    coefficients of the harmonics, with K 0, 3, 8 or 15. The order is that of the anchors and their offsets. The arrays
    are read-only; base and rest are views of one array.

    Args:
        file: a path, a URL, the bytes of a file, or a file object, as for `open`.
        limits: what the file may use, or None.

    Raises:
        ValueError: the scene is not static, so that its Gaussians depend on the view. `refcodec.api.export` fits plain
            Gaussians to its views, and `Scene.gaussians` returns those of one view.
        BitstreamError, BoundPassedError, OSError, refcodec.statuses.UsageError: as for `decode`.
    """
    with open(file, limits=limits) as opened:
        # Nothing is decoded for a scene of another render model.
        check_static(opened.header.render)
        return opened._decoded(gaussians=1).splats
