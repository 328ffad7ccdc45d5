"""Hypothesis profiles: `ci` is derandomised; HYPOTHESIS_PROFILE=long looks longer and at random."""

from __future__ import annotations

import os

from hypothesis import HealthCheck, settings

_SLOW = [HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.filter_too_much]
settings.register_profile(
    "ci", derandomize=True, deadline=None, max_examples=60, suppress_health_check=_SLOW, print_blob=True
)
settings.register_profile("long", deadline=None, max_examples=3000, suppress_health_check=_SLOW, print_blob=True)
# Read when numba or torch is loaded: threads that wait do not spin, which on busy cores makes training ten times as slow.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "ci"))
