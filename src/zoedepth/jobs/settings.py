"""The settings of a job: everything that its outputs depend on, and their fingerprint."""

import hashlib
from dataclasses import asdict
from typing import TYPE_CHECKING

from zoedepth import __version__
from zoedepth.batch import Request
from zoedepth.calibration import Calibration
from zoedepth.predict import Predictor
from zoedepth.weights.exported import ExportedModel
from zoedepth.weights.fingerprint import content_fingerprint, fingerprint

if TYPE_CHECKING:
    from zoedepth.model.interface import DepthModel

_SAID_OTHERWISE = ("model", "weights", "calibration", "outputs")  # fields of a request


def network_fingerprint(network: "DepthModel | ExportedModel") -> str:
    """Return a hash of a network: its configuration and its weights, whatever name they came by.

    The same weights have another one in another runtime, which rounds otherwise.
    """
    if isinstance(network, ExportedModel):
        return content_fingerprint(network.path)
    import torch

    tensors = network.state_dict()
    digest = hashlib.sha256(repr(network.config).encode())
    for name, tensor in sorted(tensors.items()):
        digest.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}\n".encode())
        # As bytes, because NumPy has no bfloat16; a scalar has no last axis to look at as bytes.
        digest.update(tensor.detach().cpu().contiguous().reshape(-1).view(torch.uint8).numpy())
    return digest.hexdigest()[:16]


def job_settings(request: Request, predictor: Predictor, *, weights: str) -> dict[str, object]:
    """Return everything that the outputs of a job depend on, as plain values for people to read.

    The number of workers and the device are not among them: a job may go on elsewhere.

    Args:
        request: the files that are made.
        predictor: the network and its options.
        weights: ``network_fingerprint``.
    """
    calibration = request.calibration
    asked = {name: value for name, value in asdict(request).items() if name not in _SAID_OTHERWISE}
    if request.options.max_depth is None:
        del asked["options"]["max_depth"]  # so that jobs from before there was this option go on
    return {
        "weights": weights,
        "zoedepth": __version__,
        "save": list(request.names),
        **asked,
        "calibration": fingerprint(calibration.to_json()) if isinstance(calibration, Calibration) else None,
        "flip": predictor.flip_average,
        "pad": predictor.pad,
        "squeeze": not predictor.keep_aspect_ratio,
        "runtime": predictor.runtime,
        "camera": predictor.camera if isinstance(predictor.camera, str) else repr(predictor.camera),
        "focal_correction": predictor.focal_correction,
    }
