"""The generator of the suite's vectors."""

from .recipes import Book, Recipe


def recipes() -> list[Recipe]:
    """All vectors, in the order of the manifest."""
    # Recipes need the encoder; who only asks for the package does not.
    from . import refused, valid  # noqa: PLC0415

    book = Book()
    for part in (valid, refused):
        part.add(book)
    return book.recipes
