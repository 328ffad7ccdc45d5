"""Files of plain 3D Gaussians: one module for each format, with its reader and its writer."""
