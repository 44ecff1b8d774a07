"""Write models for other programs: ONNX, OpenVINO, torch.export. ``zoedepth.load_model`` runs the first two."""

from zoedepth.export.write import export_model
from zoedepth.weights.exported import load_exported

__all__ = ["export_model", "load_exported"]
