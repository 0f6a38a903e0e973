"""A diagnosis in plain words, for the terminal and the head of the report."""

import textwrap
from collections.abc import Sequence

from diffsea.report.phrases import Record, group_phrase, listed, title
from diffsea.report.quantities import (
    duration,
    known,
    odds,
    probability,
    rounded,
    significant,
    with_error,
)


_QUANTITIES = {"position": "m", "heading": "rad"}
_MODELS = ("nominal", "diagnosed")


def accepted(summary: Record) -> list[Record]:
    """The effects that have a name."""
    return [effect for effect in summary["effects"] if effect["name"] != "unexplained"]


def grouped(effects: list[Record]) -> list[list[Record]]:
    """Effects with the records of one that has its own size in each recording together."""
    groups: dict[object, list[Record]] = {}
    for number, effect in enumerate(effects):
        key = effect["name"] if "recording" in effect else number
        groups.setdefault(key, []).append(effect)
    return list(groups.values())


def capital(text: str) -> str:
    """The text beginning with a capital letter."""
    return text[:1].upper() + text[1:]


def alternatives(summary: Record) -> list[str]:
    """Names that the same data support nearly as well as an accepted effect."""
    names = [name for effect in accepted(summary) for name in effect.get("alternatives", [])]
    return list(dict.fromkeys(names))


def finding(summary: Record) -> str:
    """What is missing, in one sentence."""
    groups = grouped(accepted(summary))
    if not groups:
        return _without_effects(summary)
    what = listed([group_phrase(group).rstrip(",") for group in groups])
    rivals = [title(name) for name in alternatives(summary)]
    if summary["verdict"] == "unexplained":
        return (
            f"The recordings show {what}, which the model leaves out, and something else that "
            "has no name here."
        )
    if summary["verdict"] == "ambiguous" and rivals:
        return (
            f"The model leaves out {what}, or else {listed(rivals, 'or')}: these recordings "
            "cannot tell which."
        )
    return f"The recordings show {what}, which the model leaves out."


def _without_effects(summary: Record) -> str:
    if summary["verdict"] == "consistent":
        return (
            "The model agrees with the recordings: they show nothing that is missing from it "
            "beyond the values of its parameters."
        )
    where = strongest(summary)
    place = f", strongest in {where[0]}" if where else ""
    return (
        "The recordings show something that the model leaves out and that no effect known here "
        f"describes{place}."
    )


def held_out_change(summary: Record) -> str:
    """What the diagnosis does to predictions of held-out runs, in one sentence."""
    on = capital(held_out_place(summary))
    row = headline_horizon(summary.get("held_out", {}).get("horizons", []), _MODELS)
    if row is None:
        return _fit_change(summary, on)
    quantity = _headline_quantity(row, _MODELS)
    old, new = (row[model][quantity] for model in _MODELS)
    before, after = (two_digits(value, _QUANTITIES[quantity]) for value in (old, new))
    what = f"{on}, the {quantity} predicted {row['seconds']:g} s ahead is"
    if not accepted(summary):
        return f"{what} off by {after}."
    if before == after or abs(new - old) < 0.02 * old:
        return f"{what} off by {after} with or without it."
    if new > old:
        return f"{what} then off by {after}, which is worse than {before} without it."
    return f"{what} then off by {after} instead of {before}."


def held_out_place(summary: Record) -> str:
    """Where predictions were judged: `on runs kept back as a test`."""
    how = summary.get("held_out", {}).get("how", "")
    what = "the last part of each run," if "last part" in how else "runs"
    return f"on {what} kept back as a test"


def headline_horizon(rows: Sequence[Record], models: Sequence[str]) -> Record | None:
    """The errors to quote: 20 s ahead, else the longest horizon that there is."""
    rows = [row for row in rows if _headline_quantity(row, models)]
    preferred = [row for row in rows if row["seconds"] == 20]
    return (preferred or rows[-1:] or [None])[0]


def _headline_quantity(row: Record, models: Sequence[str]) -> str:
    for quantity in ("position", "heading"):
        if all(known(row[model].get(quantity)) for model in models):
            return quantity
    return ""


def two_digits(value: float, unit: str) -> str:
    """An error with two significant digits."""
    return rounded(value, 0.1 * abs(value), unit)


def _fit_change(summary: Record, on: str) -> str:
    old, new = (summary["fit"][model].get("test") for model in _MODELS)
    if not known(old) or not known(new):
        return "There was nothing held out to judge it by."
    if not accepted(summary):
        return f"{on}, the error of the next sample is {significant(new, 2)} times the noise."
    return (
        f"{on}, the error of the next sample goes from {significant(old, 2)} to "
        f"{significant(new, 2)} times the noise."
    )


def strongest(summary: Record, count: int = 3) -> list[str]:
    """Where the mismatch is, one line for each degree of freedom, strongest first."""
    lines, seen = [], []
    for cell in summary["where"]:
        degree = cell["degree_of_freedom"]
        if degree in seen:
            continue
        seen.append(degree)
        windows = [c for c in summary["where"] if c["degree_of_freedom"] == degree]
        windows = [c for c in windows if c["recording"] != "all"] or windows
        lines.append(_place(windows[0]))
    return lines[:count]


def _place(cell: Record) -> str:
    run = cell["recording"]
    when = f"{cell['start']:.0f} to {cell['end']:.0f} s"
    where = "all runs" if run == "all" else f"{run} from {when}"
    regime = cell.get("regime", "")
    regime = f", {regime}" if regime and regime != "no regime stands out" else ""
    force = significant(cell["force_rms"], 2)
    return f"{cell['degree_of_freedom']}, {where}{regime} (about {force} {cell['unit']})"


def remaining(summary: Record) -> str:
    """What the final model still does not explain, in one sentence."""
    p = summary.get("remainder_p_value")
    if not known(p):
        return ""
    if p < 0.01:
        return (
            "Structure remains in the residuals that the model does not explain "
            f"(p = {probability(p)})."
        )
    return f"No significant structure remains in the residuals (p = {probability(p)})."


def parameter_lines(effect: Record) -> list[str]:
    """`speed 0.301 +- 0.004 m/s` for each parameter of an effect."""
    lines = []
    for name, entry in effect["parameters"].items():
        text = with_error(entry["value"], entry.get("std"), entry.get("unit", ""))
        if "beyond" in entry:
            text = f"above {rounded(entry['beyond'], None, entry['unit'])}, if any"
        lines.append(f"{name.replace('_', ' ')} {text}{direction_note(effect, name)}")
    return lines


def effect_lines(name: str, copies: Sequence[Record]) -> list[str]:
    """A fitted effect in a line, or in one line for each recording."""
    lines = []
    for number, parameters in enumerate(copies, start=1):
        told = ", ".join(parameter_lines({"name": name, "parameters": parameters}))
        where = f", recording {number}" if len(copies) > 1 else ""
        lines.append(f"{title(name).replace(':', ', ')}{where}: {told}")
    return lines


def direction_note(effect: Record, parameter: str) -> str:
    """Whether a direction is where something flows to or comes from."""
    notes = {"current": " (flows to)", "wind": " (comes from)"}
    return notes.get(effect["name"], "") if parameter == "direction" else ""


def verdict_text(summary: Record) -> str:
    """The diagnosis in a few lines for the terminal."""
    lines = [*textwrap.wrap(finding(summary), 88), *textwrap.wrap(held_out_change(summary), 88), ""]
    lines += _item("where", strongest(summary))
    lines += _item("what", [_what(effect) for effect in accepted(summary)])
    lines += _item("error", error_lines(summary))
    lines += _item("left", [remaining(summary)])
    lines += _item("data", [audit_line(record) for record in summary["audit"]][:5])
    lines += _item("next", [next_line(summary)])
    return "\n".join(lines).rstrip()


def _item(label: str, texts: list[str]) -> list[str]:
    out = []
    for text in filter(None, texts):
        begin = f"{label:<7}"
        out += textwrap.wrap(text, 88, initial_indent=begin, subsequent_indent=" " * 7)
        label = ""
    return out


def _what(effect: Record) -> str:
    place = f" in {effect['recording']}" if "recording" in effect else ""
    channels = f" of {', '.join(effect['channels'])}" if effect.get("channels") else ""
    size = effect.get("evidence", {}).get("log10_odds")
    sure = f"; odds {odds(size)}" if known(size) else ""
    return f"{title(effect['name'])}{channels}{place}: {', '.join(parameter_lines(effect))}{sure}"


def error_lines(summary: Record) -> list[str]:
    """Errors of position and heading at each horizon, before and after."""
    models = _MODELS if accepted(summary) else _MODELS[1:]
    rows = summary.get("held_out", {}).get("horizons", [])
    return [line for row in rows if (line := error_line(row, models))]


def error_line(row: Record, models: Sequence[str]) -> str:
    """`20 s ahead: position 3.9 m -> 0.5 m, heading 12 deg -> 1.1 deg`."""
    parts = []
    for quantity in ("position", "heading"):
        values = [row[model].get(quantity) for model in models]
        if all(known(value) for value in values):
            texts = [two_digits(value, _QUANTITIES[quantity]) for value in values]
            parts.append(f"{quantity} {' -> '.join(texts)}")
    return f"{row['seconds']:g} s ahead: {', '.join(parts)}" if parts else ""


def audit_line(record: Record) -> str:
    """One finding of the audit."""
    return f"{title(record['kind'])} in {record['recording']}: {record['message']}"


def next_line(summary: Record) -> str:
    """The experiment that would help most."""
    proposal = summary.get("next_experiment")
    if not proposal:
        return ""
    seconds = proposal.get("seconds")
    if not known(seconds):
        return f"no manoeuvre: {proposal['why']}"
    return f"{title(proposal['manoeuvre'])} for {duration(seconds)}: {proposal['why']}"
