"""What the tables mean, written by hand after they were read."""

COMMANDS: list[str] = []
VERDICTS: list[str] = []
