"""The files of the page, held in memory: no name that a client sends is ever looked for on the disk."""

import hashlib
from pathlib import Path
from typing import NamedTuple

FOLDER = Path(__file__).parent / "page"
SHARED = (Path(__file__).parent.parent / "assets" / "viewer" / "three.min.js",)
"""Files of other folders that the page uses, too."""

_MEDIA_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".mjs": "text/javascript; charset=utf-8",
    ".json": "application/json",
    ".webmanifest": "application/manifest+json",
    ".svg": "image/svg+xml",
    ".png": "image/png",
    ".jpg": "image/jpeg",
    ".webp": "image/webp",
    ".ico": "image/x-icon",
    ".woff2": "font/woff2",
    ".wasm": "application/wasm",
    ".glb": "model/gltf-binary",
    ".txt": "text/plain; charset=utf-8",
    ".md": "text/plain; charset=utf-8",
}


class PageFile(NamedTuple):
    """A file of the page."""

    content: bytes
    media_type: str
    tag: str
    """The ETag, by which browsers know whether they have it already."""


def read_page(folder: Path = FOLDER) -> dict[str, PageFile]:
    """Return all files below the folder by the paths of their addresses; index.html is "/", too. And ``SHARED``."""
    found = {}
    named = {path: path.relative_to(folder).as_posix() for path in sorted(folder.rglob("*"))}
    for path, name in {**named, **{path: path.name for path in SHARED}}.items():
        if path.is_file() and (suffix := path.suffix.lower() or ".txt") in _MEDIA_TYPES:
            content = path.read_bytes()
            tag = f'"{hashlib.sha256(content).hexdigest()[:32]}"'
            found[f"/{name}"] = PageFile(content, _MEDIA_TYPES[suffix], tag)
    if "/index.html" in found:
        found["/"] = found["/index.html"]
    return found
