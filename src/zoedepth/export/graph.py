"""The graph of a model whose weights stay in their safetensors file, for models in the package.

ONNX Runtime then starts without torch, and the weights are there once: the graph names the place of each in that file.
"""

import json
import tempfile
from pathlib import Path
from typing import Any

from zoedepth.errors import InputError
from zoedepth.export.wrapper import ExportModel
from zoedepth.export.write import complete, write_onnx
from zoedepth.images import atomic_path
from zoedepth.weights.load import load_network

_PREFIX = "model."
"""Beginning of the names of the weights in a graph: the model is an attribute of ``ExportModel``."""


def write_graph(weights: Path) -> Path:
    """Write the graph of a model beside its weights, as NAME.onnx, which works as long as both files lie together.

    Weights of 16 bits are read as such, and become float32 in the graph.

    Args:
        weights: file of ``save_model``.

    Returns:
        The file that was written.

    Raises:
        InputError: the model cannot be exported, see ``ExportModel``, or a weight of the graph is not in the file.
        MissingExtraError: onnx is not installed.
    """
    import onnx

    model = load_network(weights)
    path = weights.with_suffix(".onnx")
    with tempfile.TemporaryDirectory() as folder:
        write_onnx(ExportModel(model).eval(), Path(folder) / path.name, fold=False)
        graph: Any = onnx.load(Path(folder) / path.name)
    places = tensor_places(weights)
    types = {"F16": onnx.TensorProto.FLOAT16, "F32": onnx.TensorProto.FLOAT}
    casts = []
    for weight in graph.graph.initializer:
        name = weight.name
        if (place := places.get(name.removeprefix(_PREFIX))) is None:
            raise InputError(f"the graph of {weights} has a weight {name}, which is not in the file")
        kind, offset, length = place
        if kind == "F16":
            weight.name = f"{name}.half"
            casts.append(onnx.helper.make_node("Cast", [weight.name], [name], to=onnx.TensorProto.FLOAT))
        weight.ClearField("raw_data")
        weight.data_type, weight.data_location = types[kind], onnx.TensorProto.EXTERNAL
        for key, value in {"location": weights.name, "offset": offset, "length": length}.items():
            entry = weight.external_data.add()
            entry.key, entry.value = key, str(value)
    nodes = [*casts, *graph.graph.node]
    del graph.graph.node[:]
    graph.graph.node.extend(nodes)
    complete(graph, model)
    with atomic_path(path) as part:
        part.write_bytes(graph.SerializeToString())
    return path


def tensor_places(weights: Path) -> dict[str, tuple[str, int, int]]:
    """Return the type of each tensor of a safetensors file, its first byte in the file, and its number of bytes."""
    with weights.open("rb") as file:
        length = int.from_bytes(file.read(8), "little")
        header = json.loads(file.read(length))
    start = 8 + length
    return {
        name: (about["dtype"], start + about["data_offsets"][0], about["data_offsets"][1] - about["data_offsets"][0])
        for name, about in header.items()
        if name != "__metadata__"
    }
