"""Evaluation against photographs: image quality, bytes, seconds."""
