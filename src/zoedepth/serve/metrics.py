"""Numbers about the service for Prometheus."""

import os
from typing import Any

from prometheus_client import (
    CONTENT_TYPE_LATEST,
    CollectorRegistry,
    Counter,
    Gauge,
    Histogram,
    ProcessCollector,
    generate_latest,
    multiprocess,
)

MEDIA_TYPE = CONTENT_TYPE_LATEST
FOLDER_VARIABLE = "PROMETHEUS_MULTIPROC_DIR"
"""Variable of the environment with the folder in which several processes add up their numbers."""

_SECONDS = (0.05, 0.1, 0.25, 0.5, 1, 2.5, 5, 10, 20, 30, 60)
_SIZES = (1, 2, 4, 8, 16, 32)
_PATHS = ("/v1/depth", "/v1/measure", "/v1/calibrate", "/v1/models", "/healthz", "/readyz", "/metrics", "/openapi.json")


class Metrics:
    """Counters and histograms of one service. With several processes, each answers with the numbers of all."""

    def __init__(self) -> None:
        registry = self._registry = CollectorRegistry()
        self._several = FOLDER_VARIABLE in os.environ
        own: dict[str, Any] = {"registry": registry}
        self._requests = Counter("zoedepth_requests", "Requests that were answered.", ["path", "status"], **own)
        self._seconds = Histogram(
            "zoedepth_request_seconds", "Seconds from head to answer.", ["path"], buckets=_SECONDS, **own
        )
        self.waiting = Gauge(
            "zoedepth_waiting", "Requests that wait for their turn.", multiprocess_mode="livesum", **own
        )
        self.computing = Gauge("zoedepth_computing", "Requests that are computed.", multiprocess_mode="livesum", **own)
        self.batch_size = Histogram(
            "zoedepth_batch_size", "Photos that went through the model together.", buckets=_SIZES, **own
        )
        self.model_seconds = Histogram(
            "zoedepth_model_seconds", "Seconds in the model for a batch.", ["model"], buckets=_SECONDS, **own
        )
        self.dropped = Counter("zoedepth_dropped", "Requests dropped because the client hung up.", **own)
        if not self._several:
            ProcessCollector(registry=registry)

    def answered(self, scope: Any, status: int, seconds: float) -> None:
        """Count a request; 0 is the status of one that got no answer."""
        path = scope["path"] if scope["path"] in _PATHS else "other"  # a client must not make up labels
        self._requests.labels(path, str(status)).inc()
        self._seconds.labels(path).observe(seconds)

    def text(self) -> bytes:
        """Return all numbers in the text format of Prometheus."""
        if not self._several:
            return generate_latest(self._registry)
        registry = CollectorRegistry()
        multiprocess.MultiProcessCollector(registry)
        return generate_latest(registry)
