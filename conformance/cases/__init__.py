"""The generator of the suite's vectors."""

from .book import Book, Recipe


def recipes() -> list[Recipe]:
    """All vectors, in the order of the manifest."""
    # What makes files needs the encoder; who only asks for the package does not.
    from . import (  # noqa: PLC0415
        coding,
        decoding,
        orders,
        outside,
        packing,
        planted,
        refused_header,
        refused_sections,
        refused_streams,
        resource,
        structure,
        whole,
    )

    book = Book()
    parts = (
        structure,
        decoding,
        coding,
        packing,
        whole,
        refused_header,
        refused_sections,
        refused_streams,
        orders,
        resource,
        planted,
        outside,
    )
    for part in parts:
        part.add(book)
    return book.recipes
