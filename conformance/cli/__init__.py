"""The command line of the conformance suite."""

from .main import main

__all__ = ["main"]
