"""Files for other programs: a scene as ordinary 3D Gaussians in four formats, and as a folder of Scaffold-GS."""
