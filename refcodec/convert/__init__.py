"""Models and splats of other programs, converted: checkpoints of the Scaffold-GS family, files of plain 3DGS."""
