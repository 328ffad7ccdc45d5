"""The scene folder: a scene in files that other programs read."""
