"""The time of zoed-lite for a photo of 480x640, by precision, mirror average and batch."""

import numpy as np

from benchmarks.timing import compare
from zoedepth import Predictor, load_model


def main() -> None:
    """Time one photo, and four at once."""
    model = load_model("zoed-lite")
    photo = np.random.default_rng(0).integers(0, 256, (480, 640, 3), dtype=np.uint8)
    plain = Predictor(model, flip_average=False)
    mirrored = Predictor(model)
    reduced = Predictor(model, flip_average=False, precision="bfloat16")
    compare("zoed-lite, one photo of 480x640", {
        "float32": lambda: plain(photo),
        "float32, mirror average": lambda: mirrored(photo),
        "bfloat16": lambda: reduced(photo),
    })  # fmt: skip
    compare("zoed-lite, four photos", {
        "one by one": lambda: [plain(photo) for _ in range(4)],
        "batch of four": lambda: plain.batch([photo] * 4),
    })  # fmt: skip
