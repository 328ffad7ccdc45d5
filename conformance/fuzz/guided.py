"""Coverage-guided fuzzing of both decoders with atheris: pip install '.[fuzz]', then

    python -m conformance.fuzz.guided out/corpus vectors -max_total_time=600

The first folder collects inputs that reach new code. Arguments after the folders are those of libFuzzer. Checksums are
repaired before decoding, unless the input's last byte is odd, so that changes reach later checks. A disagreement ends
the run, and libFuzzer keeps the file.
"""

from __future__ import annotations

import sys

import atheris

with atheris.instrument_imports(include=["refcodec", "conformance.spec_decoder"]):
    from conformance.cases.checksums import repair
    from conformance.fuzz import compare


def look(data: bytes) -> None:
    """Compares the decoders on the input without its last byte."""
    file = data[:-1]
    repaired = len(file) > 20 and not data[-1] & 1
    _, wrong = compare.compare(repair(file) if repaired else file)
    if wrong:
        raise RuntimeError(wrong)


if __name__ == "__main__":
    atheris.Setup(sys.argv, look)
    atheris.Fuzz()
