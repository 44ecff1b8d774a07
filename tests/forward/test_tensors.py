"""What ``Predictor`` asks of torch; its tests have the rest."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import torch

from zoedepth.errors import InputError
from zoedepth.forward.tensors import TensorForward, on_device
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.predict import Predictor


def test_model_stays_where_it_is_and_is_copied_elsewhere(tiny_model: ZoeDepth) -> None:
    assert on_device(tiny_model, None) is on_device(tiny_model, "cpu") is tiny_model
    moved = on_device(tiny_model, "meta")
    assert (moved.device.type, tiny_model.device.type) == ("meta", "cpu")
    with pytest.raises(InputError, match="device 'gpu' cannot be used here"):
        on_device(tiny_model, "gpu")


def test_model_in_training_mode_is_refused(tiny_model: ZoeDepth) -> None:
    forward = TensorForward(tiny_model.train(), False, False, "bicubic", "float32")
    image = np.zeros((64, 64, 3), np.uint8)
    for refused in (lambda: forward.predict([(image, (64, 64))], None, batch_size=1),
                    lambda: forward.relative(image, (64, 64))):  # fmt: skip
        with pytest.raises(InputError, match="training mode"):
            refused()


@pytest.mark.parametrize(("device", "most"), [("meta", 1), ("cpu", 3)])
def test_threads_take_turns_on_an_accelerator(
    tiny_model: ZoeDepth, monkeypatch: pytest.MonkeyPatch, device: str, most: int
) -> None:
    """Meta stands for the accelerator: a device that is not the processor. Three threads ask at once."""
    inside: set[int] = set()
    seen, all_here = [], threading.Barrier(3)

    def run(self: TensorForward, pixels: torch.Tensor, domain: torch.Tensor | None) -> None:
        inside.add(threading.get_ident())
        if device == "cpu":
            all_here.wait(300)  # they are here together, or this is broken
        time.sleep(0.01)
        seen.append(len(inside))
        if device == "cpu":
            all_here.wait(300)
        inside.discard(threading.get_ident())

    monkeypatch.setattr(TensorForward, "_run", run)
    monkeypatch.setattr(TensorForward, "_answer", lambda self, image, output: None)
    monkeypatch.setattr("zoedepth.forward.tensors._rows", lambda output, rows: None)
    forward = TensorForward(on_device(tiny_model, device), False, False, "bicubic", "float32")
    photo = (np.zeros((64, 96, 3), np.uint8), (64, 96))
    with ThreadPoolExecutor(3) as threads:
        list(threads.map(lambda _: forward.predict([photo], None, batch_size=1), range(3)))
    assert max(seen) == most


def test_float16_is_refused_where_it_is_not_computed(tiny_model: ZoeDepth) -> None:
    with pytest.raises(InputError, match="float16 is for models of torch on a GPU"):
        Predictor(tiny_model, precision="float16")
