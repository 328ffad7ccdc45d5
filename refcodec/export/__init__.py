"""A scene for other programs: ordinary 3D Gaussians fitted to its views."""

# The defaults of a fit: the degree of the harmonics, and the least-squares steps on the images.
DEGREE, ITERATIONS = 3, 10
# Square pixels: what viewers of splats add to both variances, as 3DGS, gsplat and PlayCanvas do. No format states it.
VIEWERS = 0.3
