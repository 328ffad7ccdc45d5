"""The encoder's fitter: networks and planes for a scene that has none (SPEC.md Annex B.5). Never used to decode."""
