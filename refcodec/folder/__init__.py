"""The scene folder: a scene as files that other programs can read."""
