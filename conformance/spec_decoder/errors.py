"""The error that every refused file raises."""

from .program import blocks


# SPEC 10.2, 10.3
class C3GSError(Exception):
    """A file that is refused.

    code, name, clause, meaning: of the registry. kind: the class of the error. offset: a byte of the file.
    """

    def __init__(self, name: str, offset: int) -> None:
        self.name, self.offset = name, offset
        self.code, self.kind, self.clause, self.meaning = blocks.ERRORS[name]
        super().__init__(f"{self.code} {name} ({self.kind}) at byte {offset}: {self.meaning} (clause {self.clause})")

    def as_dict(self) -> dict[str, int | str]:
        """Returns the error as a JSON object: code, name, class, offset, clause."""
        return {"code": self.code, "name": self.name, "class": self.kind, "offset": self.offset, "clause": self.clause}
