"""Learning scenes from photographs, and entropy models for scenes (torch)."""
