"""What all tests share: a model small enough to run in milliseconds, and how fuzz tests choose their examples."""

import gc
import os
import signal
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING

import jaxtyping
import pytest
from hypothesis import settings

from zoedepth.config import (
    INDOOR,
    OUTDOOR,
    AttractorConfig,
    DecoderConfig,
    EncoderConfig,
    ModelConfig,
    RouterConfig,
)

if TYPE_CHECKING:
    from zoedepth.model.zoedepth import ZoeDepth

# `make test` gives fuzz tests the same examples every time; `make fuzz` looks for new ones, and keeps what failed.
settings.register_profile("repeatable", derandomize=True, database=None, deadline=None, print_blob=True)
settings.register_profile("fuzz", derandomize=False, max_examples=1000, deadline=None, print_blob=True)
settings.load_profile("repeatable")

# Nothing that is imported or collected is ever freed: the garbage collector would look through it again and again.
gc.disable()


def pytest_configure(config: pytest.Config) -> None:
    """Let tests predict pictures of one colour, in which nothing can be seen, as they know, and reach their servers."""
    config.addinivalue_line("filterwarnings", "ignore::zoedepth.errors.InputWarning")
    # Servers of tests are on this machine, where a proxy that the environment names cannot reach them.
    os.environ["no_proxy"] = os.environ["NO_PROXY"] = "127.0.0.1,localhost"


def pytest_collection_finish() -> None:
    """Take what was imported and collected out of the garbage collector's sight, and let it look less often.

    A test makes some ten thousand objects, and imports a library now and then: both are no reason to look through all.
    """
    gc.freeze()
    gc.set_threshold(20_000, 10, 20)
    gc.enable()


@pytest.fixture(autouse=True)
def same_random_numbers() -> None:
    """Let a test draw the same numbers whichever tests ran before it in its process."""
    if "torch" in sys.modules:
        sys.modules["torch"].manual_seed(0)


@pytest.fixture(autouse=True)
def no_handler_is_left() -> Iterator[None]:
    """Take away the handler of ended children that a DataLoader's processes leave behind.

    Once a library has used a processor's matrix tiles (AMX), the small stack of handlers cannot hold them, and the next
    child that ends would end the tests.
    """
    yield
    signal_handling = sys.modules.get("torch.utils.data._utils.signal_handling")
    if signal_handling is not None and signal_handling._SIGCHLD_handler_set:
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        signal_handling._SIGCHLD_handler_set = False


@pytest.fixture(scope="session")
def tiny_config() -> ModelConfig:
    """Two domains, four BEiT blocks, every width as small as it goes."""
    return ModelConfig(
        EncoderConfig(
            "beit_base_patch16_384",
            "beit",
            size=(64, 64),
            taps=(0, 1, 2, 3),
            channels=(8, 16, 16, 16),
            width=32,
            depth=(4,),
            heads=(4,),
        ),
        decoder=DecoderConfig(widths=(16, 16, 16, 16), features=8),
        head=AttractorConfig(
            n_bins=8, n_attractors=(4, 3, 2, 1), embedding_width=16, projector_width=16, seed_width=16
        ),
        router=RouterConfig("trained", classifier="mlp", width=16),
        domains=(INDOOR, OUTDOOR),
        size=(64, 64),
    )


@pytest.fixture
def tiny_model(tiny_config: ModelConfig) -> "ZoeDepth":
    """A random model of ``tiny_config``, the same in every test, in evaluation mode."""
    # The process that only hands out the tests reads this file, too, and needs no torch.
    from tests.models import random_model

    return random_model(tiny_config)


@pytest.fixture
def unchecked_types() -> Iterator[None]:
    """Types and shapes in signatures are not checked, as in use: for tests of the errors that wrong ones get then."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)
