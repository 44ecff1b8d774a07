"""Tell what stored scores belong to: hashes of weights and of lists of photos.

They stand in the first line of every file of scores. An evaluation goes on with a folder only where they are the same.
"""

import hashlib
from pathlib import Path


def weights_fingerprint(path: Path) -> str:
    """Return a hash of a file of weights, or of ``model.safetensors`` in a folder."""
    return _fingerprint(path / "model.safetensors" if path.is_dir() else path)


def list_fingerprint(source: str) -> str | None:
    """Return a hash of a list of photos, or of ``test.csv`` in a folder; None where there is no such file."""
    path = Path(source)
    found = path / "test.csv" if path.is_dir() else path
    return _fingerprint(found) if found.is_file() else None


def _fingerprint(file: Path) -> str:
    digest = hashlib.sha256()
    with file.open("rb") as opened:
        while chunk := opened.read(1 << 20):
            digest.update(chunk)
    return digest.hexdigest()[:16]
