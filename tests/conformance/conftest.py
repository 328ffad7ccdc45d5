"""The small suite and the decoder in C, made once for all tests that need them."""

from __future__ import annotations

import pytest
from c_program import COMPILER, Program, compiled
from small_suite import Suite, build


@pytest.fixture(scope="session")
def suite(tmp_path_factory: pytest.TempPathFactory) -> Suite:
    return build(tmp_path_factory.mktemp("suite"), tmp_path_factory.mktemp("answers"))


@pytest.fixture(scope="session")
def c_decoder(tmp_path_factory: pytest.TempPathFactory) -> Program:
    """The decoder in C, with the compiler's sanitizers."""
    if COMPILER is None:
        pytest.skip("there is no C compiler here")
    return compiled(tmp_path_factory.mktemp("c"))


@pytest.fixture(scope="session")
def plain_c_decoder(tmp_path_factory: pytest.TempPathFactory) -> Program:
    """The decoder in C without sanitizers, which take address space of their own."""
    if COMPILER is None:
        pytest.skip("there is no C compiler here")
    return compiled(tmp_path_factory.mktemp("plain-c"), sanitizers=False)
