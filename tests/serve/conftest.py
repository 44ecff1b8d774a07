"""Services with a tiny model, one of which all tests share that do not change its limits."""

from collections.abc import Iterator

import pytest
from tests.models import random_model
from tests.serve.running import Client, running

from zoedepth.config import ModelConfig
from zoedepth.predict import Predictor
from zoedepth.serve.settings import Limits, Settings
from zoedepth.weights.load import load_model
from zoedepth.weights.save import save_model


@pytest.fixture(scope="session")
def model_file(tiny_config: ModelConfig, tmp_path_factory: pytest.TempPathFactory) -> str:
    """A file of a tiny random model, called tiny."""
    model = random_model(tiny_config)
    path = tmp_path_factory.mktemp("serve") / "tiny.safetensors"
    save_model(model, path)
    return str(path)


@pytest.fixture(scope="session")
def predictor(model_file: str) -> Predictor:
    """A predictor of the same model, as the command line has it."""
    return Predictor(load_model(model_file))


@pytest.fixture(scope="session")
def client(model_file: str) -> Iterator[Client]:
    """A client of a service with small limits."""
    limits = Limits(max_body=2_000_000, max_pixels=1_000_000)
    with running(Settings((model_file,), threads=2, limits=limits)) as client:
        yield client
