"""The encoder's choices (SPEC.md Annex B), from float attributes to a scene of integers. Informative: any other choice is as valid."""
