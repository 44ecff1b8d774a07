"""Models for other programs, and running them here: ONNX, OpenVINO, torch.export."""

from zoedepth.export.exported import ExportedModel, is_exported, load_exported, open_model
from zoedepth.export.write import export_model

__all__ = ["ExportedModel", "export_model", "is_exported", "load_exported", "open_model"]
