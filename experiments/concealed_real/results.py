"""Results as they grow: one line of JSON a case, appended, so that a stopped run goes on."""

import json
from pathlib import Path
from typing import Any

from experiments.concealed_real.checks import Line


HERE = Path(__file__).resolve().parent
FOLDER = HERE / "results"
PARTS = ("unchanged", "again", "told", "facts", "injected", "injected_again")
SHOWN_PLACES = 6  # of `where`, strongest first
DIGITS = 6


def path_of(part: str, folder: Path = FOLDER) -> Path:
    """The file of a part."""
    return folder / f"{part}.jsonl"


def append(part: str, line: Line, folder: Path = FOLDER) -> None:
    """Add a line; a line that was cut off by a stop before is ended first."""
    folder.mkdir(parents=True, exist_ok=True)
    path = path_of(part, folder)
    whole = not path.exists() or path.read_bytes()[-1:] in (b"\n", b"")
    with path.open("a", encoding="utf-8") as file:
        file.write(("" if whole else "\n") + json.dumps(_rounded(line)) + "\n")


def read(part: str, folder: Path = FOLDER) -> dict[str, Line]:
    """The last whole line of every case, by its id."""
    path, found = path_of(part, folder), {}
    for text in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
        try:
            line = json.loads(text)
        except ValueError:  # cut off
            continue
        found[line["id"]] = line
    return found


def summarised(record: dict[str, Any]) -> Line:
    """What a line keeps of diagnosis.json: verdict, effects, places, audit, misfits, free runs."""
    return {
        "verdict": record["verdict"],
        "complete": record.get("complete", True),
        "effects": [_effect(effect) for effect in record["effects"]],
        "where": record["where"][:SHOWN_PLACES],
        "audit": audit_lines(record["audit"]),
        "fit": {
            name: {part: entry.get(part) for part in ("train", "test")}
            for name, entry in record["fit"].items()
        },
        "free": free_errors(record),
        "remainder_p_value": record.get("remainder_p_value"),
    }


def _effect(effect: dict[str, Any]) -> dict[str, Any]:
    kept = ("name", "parameters", "alternatives", "actuators", "channels", "recording")
    evidence = effect.get("evidence", {})
    shown = {key: evidence.get(key) for key in ("log10_odds", "held_out_gain")}
    return {key: effect[key] for key in kept if key in effect} | {"evidence": shown}


def audit_lines(findings: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Findings of an audit without their prose."""
    kept = ("kind", "recording", "value", "std", "unit", "channels")
    return [{key: one[key] for key in kept if key in one} for one in findings]


def free_errors(record: dict[str, Any]) -> dict[str, dict[str, dict[str, float]]]:
    """Errors of free predictions on held-out runs: model, then s ahead, then quantity."""
    stated = {model: entry["free"] for model, entry in record["fit"].items() if entry.get("free")}
    if stated:
        return stated
    rows = record.get("held_out", {}).get("horizons", ())
    return {
        model: {f"{row['seconds']:g}": row[model] for row in rows if model in row}
        for model in ("nominal", "diagnosed")
    }


def names(line: Line) -> list[str]:
    """Names of the catalogue that a line gives, each once."""
    given = (effect["name"] for effect in line.get("effects", ()))
    return [name for name in dict.fromkeys(given) if name != "unexplained"]


def _rounded(value: Any) -> Any:
    """Numbers with few digits, what is not finite as null."""
    if isinstance(value, dict):
        return {str(key): _rounded(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(entry) for entry in value]
    if isinstance(value, bool | int | str) or value is None:
        return value
    number = float(value)
    return float(f"{number:.{DIGITS}g}") if abs(number) < float("inf") else None
