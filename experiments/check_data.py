"""Where the recordings of real vessels lie, and whether they are those of the experiments.

    python experiments/check_data.py [SET ...]

They are no part of this project: `DATA.md` says who publishes each set and how to lay it out.
`data.sha256` has the SHA-256 of every file, as `sha256sum` writes it. Ends with status 1 where a
file is missing or another one. Imports nothing but the standard library.
"""

import hashlib
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path


HERE = Path(__file__).resolve().parent
HASHES = HERE / "data.sha256"
USUAL = HERE.parents[1] / "shared" / "data"  # beside the repository


def data_folder() -> Path:
    """The folder of real recordings: that of `DIFFSEA_DATA`, else `../shared/data`."""
    chosen = os.environ.get("DIFFSEA_DATA")
    return Path(chosen).expanduser().resolve() if chosen else USUAL


def absent(what: str) -> str:
    """The message where recordings are not there: what is lacking, where, and what to do."""
    return f"no recordings of {what} in {data_folder()}; experiments/DATA.md says how to get them"


def known_hashes(text: str) -> dict[str, str]:
    """SHA-256 by path, of lines as `sha256sum` writes them."""
    pairs = (line.split(maxsplit=1) for line in text.splitlines() if line.strip())
    return {path: digest for digest, path in pairs}


def compare(folder: Path, known: Mapping[str, str]) -> dict[str, dict[str, list[str]]]:
    """Paths of each set (the first folder of a path) that are `as known`, `other` or `missing`."""
    found: dict[str, dict[str, list[str]]] = {}
    for path, digest in known.items():
        file = folder / path
        if not file.is_file():
            state = "missing"
        else:
            is_known = hashlib.sha256(file.read_bytes()).hexdigest() == digest
            state = "as known" if is_known else "other"
        of_set = found.setdefault(path.partition("/")[0], {})
        of_set.setdefault(state, []).append(path)
    return found


def told(name: str, states: Mapping[str, Sequence[str]]) -> list[str]:
    """What there is to say of a set: one line where it is whole or absent, else its files."""
    missing, other = states.get("missing", ()), states.get("other", ())
    count = sum(map(len, states.values()))
    if not missing and not other:
        return [f"{name}: all {count} files"]
    if len(missing) == count:
        return [f"{name}: missing, all {count} files"]
    lines = [f"{name}: {len(states.get('as known', ()))} of {count} files"]
    lines += [f"  missing: {path}" for path in missing]
    return [*lines, *(f"  another file than was used: {path}" for path in other)]


def main(words: Sequence[str]) -> int:
    """Say what is there of the sets named, or of all, and return the exit status."""
    known = known_hashes(HASHES.read_text(encoding="ascii"))
    sets = sorted({path.partition("/")[0] for path in known})
    if unknown := [word for word in words if word not in sets]:
        print(f"no set {', '.join(unknown)}; there are {', '.join(sets)}", file=sys.stderr)
        return 2
    chosen = {path: one for path, one in known.items() if path.partition("/")[0] in (words or sets)}
    folder = data_folder()
    found = compare(folder, chosen)
    print(f"{folder}:")
    for name, states in found.items():
        print("\n".join(told(name, states)))
    whole = all(set(states) == {"as known"} for states in found.values())
    if not whole:
        print("experiments/DATA.md says where the files come from; DIFFSEA_DATA names the folder.")
    return 0 if whole else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
