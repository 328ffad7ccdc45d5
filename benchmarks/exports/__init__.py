"""What other programs make of an exported scene: quality and bytes of each format, and clients that others wrote."""
