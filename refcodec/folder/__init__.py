"""Scenes as files: the scene folder, which other programs can read, and what commands read and write."""
