"""Peers of the format in one harness: plain 3DGS as PLY, SPZ and SOG, and C3GS."""
