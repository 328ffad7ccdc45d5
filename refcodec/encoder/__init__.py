"""The encoder's choices (SPEC.md Annex B), from float attributes to a scene of integers.

Annex B is informative: files of encoders with other choices are equally valid.
"""
