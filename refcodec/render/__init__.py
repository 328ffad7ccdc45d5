"""Rendering (SPEC.md chapter 14): cameras, Gaussians, images. Needs the extra `render`, but for `camera` and `gaussians`."""
