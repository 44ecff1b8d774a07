"""Keep what OpenVINO has compiled for pixels of one shape in a file, which a second start reads in place of compiling.

ZoeD-M12-NK in float32 takes 1.4 GB for each shape. The file is mapped into memory: its weights are there once, and the
graph that they were compiled from is not touched (docs/performance.md).
"""

import json
import logging
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from zoedepth.images import atomic_path
from zoedepth.weights.fingerprint import files_state, fingerprint
from zoedepth.weights.openvino_processor import UNMERGED

MOST = 3
"""Number of files that are kept: those that were used last."""

_SUFFIX = ".compiled"
_HEAD = 4096
"""Bytes before the graph: what it was compiled of and with, as JSON, and spaces. Whole pages: the rest is mapped."""
_log = logging.getLogger(__name__)


class CompiledGraphs:
    """A folder of compiled graphs of one exported file, on one machine, of one version of OpenVINO.

    Args:
        folder: the folder, which need not be there.
        core: OpenVINO's core, which reads them.
        file: the exported file (.xml), as it is before it is read; its weights are beside it.
    """

    def __init__(self, folder: Path, core: Any, file: Path) -> None:
        import openvino

        self.folder = folder
        self.core = core
        parts = (file.absolute(), file.absolute().with_suffix(".bin"))
        self.origin = fingerprint([files_state(parts), openvino.__version__])
        """A hash of what all graphs are compiled of: the files, by size and times, and the version of OpenVINO."""
        self.mapped: list[Any] = []
        """The memory of the graphs that were read, which they use for as long as they live."""

    def read(self, shape: Sequence[int], *, std: bool, properties: Mapping[str, Any]) -> Any | None:
        """Return the graph for a shape of pixels; None where none is kept, or it cannot be used.

        Args:
            shape: (batch, 3, height, width).
            std: with the standard deviation.
            properties: options to compile with. Of them, only the precision decides which graph it is.
        """
        path = self._path(shape, std, properties)
        try:
            with path.open("rb") as file:
                kept = json.loads(file.read(_HEAD))
            if kept["bytes"] != path.stat().st_size - _HEAD:
                raise ValueError("it is not whole")
            if kept.get("origin") != self.origin:
                raise ValueError("it is of another file, of one that has changed, or of another version of OpenVINO")
            # Copied on write: OpenVINO takes no memory that cannot be written to, and writes nothing.
            content = np.memmap(path, np.uint8, mode="c", offset=_HEAD)
            import openvino

            tensor = openvino.Tensor(np.asarray(content), shared_memory=True)
            compiled = self.core.import_model(tensor, "CPU", {**properties, **kept["properties"]})
        except FileNotFoundError:
            return None
        except (OSError, RuntimeError, ValueError, KeyError, TypeError) as error:
            _log.warning("%s cannot be used (%s): the graph is compiled again", path, str(error)[:300])
            return None
        self.mapped += [content, tensor]
        with suppress(OSError):  # used now; of another user, it may be read only
            path.touch()
        return compiled

    def write(self, compiled: Any, shape: Sequence[int], *, std: bool, properties: Mapping[str, Any]) -> None:
        """Keep a graph, and remove those that were not used for longest. Where that fails, nothing is kept.

        Args:
            compiled: the compiled graph.
            shape: see ``read``.
            std: see ``read``.
            properties: options it was compiled with.
        """
        path = self._path(shape, std, properties)
        merging = {name: value for name, value in properties.items() if name in UNMERGED}
        try:
            with atomic_path(path) as part, part.open("wb") as file:
                content = compiled.export_model()
                content = content.getbuffer() if hasattr(content, "getbuffer") else content
                head = {"bytes": len(content), "origin": self.origin, "properties": merging}
                file.write(json.dumps(head).encode().ljust(_HEAD))
                file.write(content)
            kept = sorted(self.folder.glob(f"*{_SUFFIX}"), key=lambda each: each.stat().st_mtime)
            for old in kept[:-MOST]:
                old.unlink(missing_ok=True)
        except (OSError, RuntimeError) as error:
            _log.warning("the compiled graph was not kept in %s (%s)", self.folder, str(error)[:300])

    def _path(self, shape: Sequence[int], std: bool, properties: Mapping[str, Any]) -> Path:
        key = fingerprint([list(shape), std, properties["INFERENCE_PRECISION_HINT"]])
        return self.folder / f"{key}{_SUFFIX}"
