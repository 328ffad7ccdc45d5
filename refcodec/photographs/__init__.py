"""Folders of posed photographs: COLMAP and NeRF, lenses, sizes."""
