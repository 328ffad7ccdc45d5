"""Rendering (SPEC.md chapter 14): cameras, Gaussians, images.

All modules but `camera` and `gaussians` need the extra `render`.
"""
