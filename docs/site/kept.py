"""What the build makes with the library, made once for each state of its sources."""

import hashlib
from collections.abc import Iterable
from pathlib import Path


ROOT = Path(__file__).resolve().parents[2]
KEPT = ROOT / "out" / "site-cache"


def state_of(paths: Iterable[Path]) -> str:
    """A digest of the library, the examples and the files given: another one, another result."""
    folders = (ROOT / "src", ROOT / "examples")
    files = {path for folder in folders for path in folder.rglob("*") if path.is_file()}
    digest = hashlib.sha256()
    for path in sorted(files | set(paths)):
        if path.suffix != ".pyc":
            digest.update(path.relative_to(ROOT).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()
