"""The small suite and the decoders, made once for all tests that need them."""

from collections.abc import Iterator

import pytest
from c_program import COMPILER, Program, compiled
from decoders import Decoders, started
from small_suite import Suite, build
from web_program import Decoder, running


@pytest.fixture(scope="session")
def suite(tmp_path_factory: pytest.TempPathFactory) -> Suite:
    return build(tmp_path_factory.mktemp("suite"), tmp_path_factory.mktemp("answers"))


@pytest.fixture(scope="session")
def decoders(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Decoders]:
    with started(tmp_path_factory.mktemp("decoders")) as every:
        yield every


@pytest.fixture(scope="session")
def c_decoder(decoders: Decoders) -> Program:
    """The decoder in C, with the compiler's sanitizers."""
    decoder = decoders.others.get("C")
    if not isinstance(decoder, Program):
        pytest.skip("there is no C compiler here")
    return decoder


@pytest.fixture(scope="session")
def decoder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Decoder]:
    """The decoder in WebAssembly and JavaScript."""
    with running(tmp_path_factory.mktemp("web")) as process:
        yield process


@pytest.fixture(scope="session")
def plain_c_decoder(tmp_path_factory: pytest.TempPathFactory) -> Program:
    """The decoder in C without sanitizers, which take address space of their own."""
    if COMPILER is None:
        pytest.skip("there is no C compiler here")
    return compiled(tmp_path_factory.mktemp("plain-c"), sanitizers=False)
