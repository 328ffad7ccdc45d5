"""Coverage-guided fuzzing of both decoders with atheris: pip install '.[fuzz]', then

    python -m conformance.fuzz.guided out/corpus vectors -max_total_time=600

The first folder collects what reaches new code. Arguments after the folders are libFuzzer's. Checksums are repaired
before a file is decoded, unless the input's last byte is odd, so that changes reach what lies behind them. A
disagreement ends the run, and libFuzzer keeps the file.
"""

from __future__ import annotations

import sys

import atheris

with atheris.instrument_imports(include=["refcodec", "conformance.spec_decoder"]):
    from conformance.cases.checksums import repair
    from conformance.fuzz import compare


def look(data: bytes) -> None:
    """One file, all but the last byte of the input."""
    file = data[:-1]
    repaired = len(file) > 20 and not data[-1] & 1
    _, wrong = compare.compare(repair(file) if repaired else file)
    if wrong:
        raise RuntimeError(wrong)


if __name__ == "__main__":
    atheris.Setup(sys.argv, look)
    atheris.Fuzz()
