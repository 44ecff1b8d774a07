"""What tests of exports share."""

from dataclasses import replace

import pytest

from zoedepth.config import AttractorConfig, ModelConfig


@pytest.fixture(scope="session")
def tiny_config(tiny_config: ModelConfig) -> ModelConfig:
    """The small config with fewer attractors: each is several operations in every graph that is traced and compiled."""
    assert isinstance(tiny_config.head, AttractorConfig)
    return replace(tiny_config, head=replace(tiny_config.head, n_attractors=(2, 1, 1, 1)))
