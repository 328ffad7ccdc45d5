"""Files for other programs: a scene as ordinary 3D Gaussians in four formats, and as a folder of Scaffold-GS."""

# The defaults of a fit: the degree of the harmonics, and the least-squares steps on the images.
DEGREE, ITERATIONS = 3, 10
