"""SHA-256 of what lies on disk, which says later whether it is still the same."""

import hashlib
from pathlib import Path


def content_digest(path: Path) -> str:
    """SHA-256 of a file; of a folder, that of the names and digests of what is in it.

    Raises:
        OSError: something of it cannot be read.
    """
    if path.is_dir():
        parts = [f"{item.name} {content_digest(item)}\n" for item in sorted(path.iterdir())]
        return hashlib.sha256("".join(parts).encode()).hexdigest()
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
