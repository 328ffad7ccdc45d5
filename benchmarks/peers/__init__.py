"""Peers of the format in one harness: plain 3DGS, with SPZ and SOG of it, and C3GS."""
