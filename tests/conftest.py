"""What all tests share: profiles of hypothesis, SPEC.md's blocks, and an environment that is the same on every machine.

Profiles: `ci` is derandomised; HYPOTHESIS_PROFILE=long looks longer and at random, `smoke` only briefly.
"""

import os
import signal
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

_SLOW = [HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.filter_too_much]
settings.register_profile(
    "ci", derandomize=True, deadline=None, max_examples=60, suppress_health_check=_SLOW, print_blob=True
)
settings.register_profile("smoke", settings.get_profile("ci"), max_examples=8)
settings.register_profile("long", deadline=None, max_examples=3000, suppress_health_check=_SLOW, print_blob=True)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "ci"))

# Processes that tests start import this tree too, whatever folder they are in and whatever is installed.
_ROOT = str(Path(__file__).resolve().parents[1])
os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [_ROOT, os.environ.get("PYTHONPATH")]))
# Read when numba or torch is loaded: two threads, whatever the machine has. Those that wait do not spin, which on
# busy cores makes training ten times as slow.
os.environ.update(NUMBA_NUM_THREADS="2", OMP_NUM_THREADS="2", OMP_WAIT_POLICY="PASSIVE")

# In the background a shell ignores Ctrl-C, and nohup the end of the terminal. Python and the commands then do so, too,
# and tests would not interrupt them.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)


class _Names(dict[str, Any]):
    """hypothesis writes the arguments of an example out, which takes a fifth of a second for the tables."""

    def __repr__(self) -> str:
        return "spec"


@pytest.fixture(scope="session")
def spec() -> dict[str, Any]:
    """The names that SPEC.md's python blocks define: what a step of the decoding process gives is what they say."""
    # Not every test needs the codec.
    from conformance import spec_decoder  # noqa: PLC0415

    return _Names(spec_decoder.names())
