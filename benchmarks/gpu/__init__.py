"""Whether a GPU trains as the CPU does: see __main__."""
