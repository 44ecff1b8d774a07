"""Write the graph of the model in the package anew, after its weights have changed.

    python scripts/package_graph.py

``zoedepth predict`` runs it in ONNX Runtime, on the weights in the safetensors file beside it (``export/graph.py``).
"""

from zoedepth.export.graph import write_graph
from zoedepth.weights.releases import RELEASES


def main() -> None:
    """Write the graphs of all models in the package."""
    for release in RELEASES.values():
        if release.graph is not None:
            print(write_graph(release.path))


if __name__ == "__main__":
    main()
