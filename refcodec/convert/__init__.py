"""Models and splats of other programs, converted: checkpoints of the Scaffold-GS family, plain 3D Gaussians."""
