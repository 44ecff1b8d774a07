"""Settings: whatever changes the outputs changes the fingerprint, and nothing else does."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from zoedepth.batch import Request
from zoedepth.calibration import Calibration
from zoedepth.geometry.lens import Lens
from zoedepth.jobs.manifest import fingerprint_of
from zoedepth.jobs.settings import job_settings, network_fingerprint
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.outputs import Options
from zoedepth.predict import Predictor
from zoedepth.weights.exported import ExportedModel


def of(model: ZoeDepth, request: Request | None = None, predictor: Predictor | None = None) -> str:
    weights = network_fingerprint(model)
    return fingerprint_of(job_settings(request or Request("a"), predictor or Predictor(model), weights=weights))


@pytest.mark.parametrize(
    "request_",
    [
        Request("a", ("npy",)),
        Request("a", domain="indoor"),
        Request("a", panorama=True),
        Request("a", tiles="auto"),
        Request("a", tiles=(2, 3)),
        Request("a", options=Options(vmax=9.0)),
        Request("a", options=Options(max_depth=9.0)),
        Request("a", calibration=Calibration(1.5)),
    ],
)
def test_every_request_is_another_job(tiny_model: ZoeDepth, request_: Request) -> None:
    assert of(tiny_model, request_) != of(tiny_model)


@pytest.mark.parametrize(
    "predictor",
    [
        lambda model: Predictor(model, flip_average=False),
        lambda model: Predictor(model, pad=not model.config.pad),
        lambda model: Predictor(model, precision="bfloat16"),
        lambda model: Predictor(model, camera=Lens(fov_x=70)),
        lambda model: Predictor(model, camera=Lens(fov_x=71)),
        lambda model: Predictor(model, focal_correction=False),
        lambda model: Predictor(model, resize="squeeze"),
    ],
)
def test_every_option_of_the_predictor_is_another_job(
    tiny_model: ZoeDepth, predictor: Callable[[ZoeDepth], Predictor]
) -> None:
    assert of(tiny_model, predictor=predictor(tiny_model)) != of(tiny_model)


def test_options_that_are_new_do_not_change_the_jobs_from_before(tiny_model: ZoeDepth) -> None:
    settings = job_settings(Request("a"), Predictor(tiny_model), weights="1")
    assert settings["options"] == {
        "png_scale": None, "vmin": None, "vmax": None, "colormap": "magma_r", "max_triangles": 500_000,
    }  # fmt: skip


def test_names_of_the_model_and_of_outputs_do_not_matter(tiny_model: ZoeDepth) -> None:
    assert of(tiny_model, Request("b")) == of(tiny_model)
    assert of(tiny_model, Request("b", ("png", "preview"))) == of(tiny_model)


def test_weights_and_configuration_are_known_by_their_content(tiny_model: ZoeDepth) -> None:
    before = network_fingerprint(tiny_model)
    assert network_fingerprint(tiny_model) == before
    weight = next(iter(tiny_model.state_dict().values()))
    with torch.no_grad():
        weight.view(-1)[-1] += 1
    changed = network_fingerprint(tiny_model)
    assert changed != before
    tiny_model.config = replace(tiny_model.config, pad=not tiny_model.config.pad)
    assert network_fingerprint(tiny_model) not in (before, changed)


def test_an_exported_model_is_known_by_its_file(tmp_path: Path, tiny_model: ZoeDepth) -> None:
    class Exported(ExportedModel):
        def __init__(self) -> None:
            self.config, self.path = tiny_model.config, file

        def run(self, inputs: object, *, std: bool) -> dict:
            raise AssertionError("its weights are in no tensors here")

    file = tmp_path / "m.onnx"
    prints = []
    for content in (b"1", b"2", b"1"):
        file.write_bytes(content)
        prints.append(network_fingerprint(Exported()))
    assert prints[0] == prints[2] != prints[1]
