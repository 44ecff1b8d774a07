"""What ``Predictor`` asks of torch; its tests have the rest."""

import numpy as np
import pytest

from zoedepth.errors import InputError
from zoedepth.forward.tensors import TensorForward, on_device
from zoedepth.model.zoedepth import ZoeDepth


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
