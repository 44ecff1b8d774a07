# zoedepth serve on the CPU (docs/serve.md):
#
#   docker build -t zoedepth .
#   docker run --rm --read-only --shm-size 1g -p 127.0.0.1:8000:8000 zoedepth
#
# `scripts/dockerfile.py` runs these steps one by one without Docker.
FROM python:3.12-slim AS build
# Torch for the CPU alone: the one with CUDA takes gigabytes.
ARG TORCH_INDEX=https://download.pytorch.org/whl/cpu
ENV PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1
WORKDIR /src
RUN python -m venv /opt/zoedepth
RUN /opt/zoedepth/bin/pip install --index-url $TORCH_INDEX torch torchvision
COPY pyproject.toml README.md LICENSE ./
COPY src ./src
RUN /opt/zoedepth/bin/pip install '.[serve,exr,mesh,heic]'

FROM python:3.12-slim
COPY --from=build /opt/zoedepth /opt/zoedepth
ENV PATH=/opt/zoedepth/bin:$PATH HOME=/nonexistent PYTHONDONTWRITEBYTECODE=1 PYTHONUNBUFFERED=1
# Nobody's number: it owns no file, and none is ever written.
USER 65532:65532
EXPOSE 8000
STOPSIGNAL SIGTERM
HEALTHCHECK --interval=30s --timeout=5s --start-period=60s CMD ["python", "-c", "import urllib.request as r; r.urlopen('http://127.0.0.1:8000/readyz', timeout=4)"]
ENTRYPOINT ["zoedepth", "serve", "--host", "0.0.0.0", "--port", "8000"]
