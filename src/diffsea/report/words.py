"""Results in plain words: effects and their sizes, and what a diagnosis says of a model.

The same sentences stand in the terminal and at the head of a page, so that they never differ.
"""

import math
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from diffsea.identification.holdout import HeldOut
from diffsea.identification.sufficiency import Shortfall
from diffsea.parameters import parameter_meaning
from diffsea.recordings import MAPPING_KINDS
from diffsea.report.quantities import (
    duration,
    is_known,
    odds,
    odds_or_bound,
    p_equals,
    round_to_error,
    significant,
    with_error,
)
from diffsea.trajectory import in_words
from diffsea.vessel.effects import EFFECTS, Effect, catalogue_name
from diffsea.vessel.effects.actuators import SIDES
from diffsea.vessel.effects.sensors import MeasuredChannels


Record = dict[str, Any]  # a part of diagnosis.json or fit.json

# What symbols of effects mean that are no parameters of a vessel file.
SYMBOLS = {
    "C_X": "wind coefficient ahead",
    "C_Y": "wind coefficient abeam",
    "C_N": "wind coefficient in yaw",
    "Y_phi": "sway force from heel",
    "N_phi": "yaw moment from heel",
    "Y_vdot - X_udot": "added mass, sway less surge",
    "a_H": "hull's share of the rudder's force",
    "x_H": "where that share acts",
    "gamma_R": "straightening of the rudder's inflow",
    "cd": "cross-flow drag coefficient",
    **{f"{force}_{way}": f"{what} of a propeller {way}, in thrusts"
       for force, what in (("Y", "side force"), ("N", "moment")) for way in ("ahead", "astern")},
}  # fmt: skip
PERCENT_SCALES = {"%": 100.0, "%/deg": math.radians(100.0)}
MODELS = ("nominal", "diagnosed")
HEADLINE_SECONDS = 20  # ahead: far enough for errors to grow, short enough for most runs
SURE_REMAINDER = 0.01  # p-value below which structure is said to remain
LINE_WIDTH = 88  # characters, of a terminal
LABEL_WIDTH = 7  # characters, of the word before a line
LITTLE_LEFT = 0.2  # of an error, which is worth saying
LISTED_FINDINGS = 5  # of the audit, on a terminal
_LATE = "sensor-latency"  # the name of the catalogue
_QUANTITIES = {"position": "m", "heading": "rad"}  # whose errors are quoted


def as_words(name: str) -> str:
    """A catalogue name as words: `thrust-lag` is `thrust lag`."""
    return name.replace("-", " ")


def enumeration(items: list[str], last: str = "and") -> str:
    """`a, b and c`."""
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} {last} {items[-1]}"


class PhrasedParameter:
    """A parameter of an effect, formatted as the braces of the effect's phrase ask for it.

    `{speed}` is the value in people's units, `{time:size}` its absolute value, `{ratio:%}` that
    in percent, `{slope:%/deg}` in percent per degree, `{angle:starboard|port}` a word for its sign.
    """

    def __init__(self, entry: Record):
        """
        Arguments:
            entry: `value`, `std` and `unit` of the parameter, in SI units.
        """
        self.value, self.std, self.unit = entry["value"], entry.get("std"), entry.get("unit", "")

    def __format__(self, form: str) -> str:
        if not form:
            return round_to_error(self.value, self.std, self.unit)
        if "|" in form:
            positive, other = form.split("|")
            return positive if self.value is not None and self.value > 0 else other
        if not is_known(self.value):
            return "an unknown amount"
        scale = PERCENT_SCALES.get(form, 1.0)
        std = self.std * scale if is_known(self.std) else None
        unit = "%" if form in PERCENT_SCALES else self.unit
        return round_to_error(abs(self.value) * scale, std, unit)


def catalogue_entry(effect: Record) -> Effect | None:
    """The effect's entry of the catalogue: of variants that with its channels or parameters."""
    name, late = effect["name"], set(effect.get("channels", ()))
    variants = [one for one in EFFECTS.values() if name in (one.name, catalogue_name(one.name))]
    alike = [
        one
        for one in variants
        if isinstance(one.place, MeasuredChannels) and set(one.place.names) == late
    ]
    told = [one for one in variants if set(one.units) == set(effect["parameters"])]
    return (alike or told or variants or [None])[0]


def phrase(effect: Record) -> str:
    """An effect and its size as a phrase: `a steady current of 0.30 m/s flowing to 69 deg`."""
    entry = catalogue_entry(effect)
    parts: dict[str, object] = {k: PhrasedParameter(e) for k, e in effect["parameters"].items()}
    parts["actuators"] = f"the {enumeration(_actuator_words(effect.get('actuators', ())))}"
    parts["channels"] = enumeration(in_words(effect.get("channels", ())) or ["signal"])
    try:
        text = entry.phrase.format(**parts) if entry and entry.phrase else ""
    except KeyError:  # a record without a parameter that the phrase names
        text = ""
    return text or f"the effect {as_words(effect['name'])!r}"


def acted_on(effect: Record) -> str:
    """What an effect acts on, where it has a choice: ` of heading, yaw rate`."""
    names = [*in_words(effect.get("channels") or ()), *(effect.get("actuators") or ())]
    return f" of {', '.join(names)}" if names else ""


def _actuator_words(names: Sequence[str]) -> list[str]:
    """Actuators in a phrase; those that have but the name of a side need a noun."""
    return [f"{one} actuator" if one in SIDES else one for one in names] or ["actuators"]


def phrases(effects: list[Record]) -> list[str]:
    """What was found, a phrase each; several delays of sensors are one."""
    late = [one for one in effects if one["name"] == _LATE and "recording" not in one]
    together = late if len(late) > 1 else []
    told = [_late_together(together)] if together else []
    others = [one for one in effects if one not in together]
    return told + [_group_phrase(group).rstrip(",") for group in effect_groups(others)]


def _late_together(late: list[Record]) -> str:
    """Several sensors that are late: each by itself, for what is ahead of one lags another."""
    delays = [PhrasedParameter(one["parameters"]["delay"]) for one in late]
    channels = [enumeration(in_words(one["channels"])) for one in late]
    parts = [f"{names} by {delay}" for names, delay in zip(channels, delays, strict=True)]
    return f"late measurements ({'; '.join(parts)})"


def _group_phrase(group: list[Record]) -> str:
    """One effect as a phrase, or one that has its own size in each recording."""
    if len(group) == 1:
        return phrase(group[0])
    text = f"a {as_words(group[0]['name'])} of its own in each recording"
    if group[0]["parameters"]:
        first, entry = next(iter(group[0]["parameters"].items()))
        sizes = [effect["parameters"].get(first, {}).get("value") for effect in group]
        values, unit = [float(size or 0.0) for size in sizes], entry.get("unit", "")
        low, high = (round_to_error(end(values), None, unit) for end in (min, max))
        text += f" ({first} {low} to {high})"
    return text


def named_effects(summary: Record) -> list[Record]:
    """The effects that have a name."""
    return [effect for effect in summary["effects"] if effect["name"] != "unexplained"]


def effect_groups(effects: list[Record]) -> list[list[Record]]:
    """Effects with the records of one that has its own size in each recording together."""
    groups: dict[object, list[Record]] = {}
    for number, effect in enumerate(effects):
        key = effect["name"] if "recording" in effect else number
        groups.setdefault(key, []).append(effect)
    return list(groups.values())


def capital(text: str) -> str:
    """The text beginning with a capital letter."""
    return text[:1].upper() + text[1:]


def count_recordings(number: int) -> str:
    """How many recordings, in words: `1 recording`, `3 recordings`."""
    return "1 recording" if number == 1 else f"{number} recordings"


def verdict_sentence(summary: Record) -> str:
    """What is missing, in one sentence.

    Arguments:
        summary: the content of diagnosis.json; so in all functions below.
    """
    effects = named_effects(summary)
    if summary["verdict"] == "consistent" and not effects:
        return (
            "The model agrees with the recordings: they show nothing that is missing from it "
            "beyond the values of its parameters. What it misses is put down to gusts and sensor "
            "noise; if it was calm, more than sensor noise means that something is missing."
        )
    if not effects and summary["verdict"] != "insufficient":
        where = "".join(f", strongest in {place}" for place in strongest_places(summary, 1))
        return (
            "The recordings show something that the model leaves out and that no effect known here "
            f"describes{where}."
        )
    if summary["verdict"] == "insufficient":
        why = enumeration([Shortfall(one).sentence for one in summary["insufficient"]])
        return f"The recordings do not tell whether the model lacks anything: {why}."
    what = enumeration(phrases(effects))
    names = dict.fromkeys(name for one in effects for name in one.get("alternatives", []))
    if summary["verdict"] == "unexplained":
        return (
            f"The recordings show {what}, which the model leaves out, and something else that "
            "has no name here."
        )
    if summary["verdict"] == "ambiguous" and names:
        rivals = enumeration([as_words(name) for name in names], "or")
        return f"The model leaves out {what}, or else {rivals}: these recordings cannot tell which."
    return f"The recordings show {what}, which the model leaves out."


def prediction_sentence(summary: Record) -> str:
    """What the diagnosis does to predictions of held-out runs, in one sentence."""
    held_out, found = summary.get("held_out", {}), named_effects(summary)
    parts = held_out.get("kind") == HeldOut.LAST_PARTS
    on = f"On {'the last part of each run,' if parts else 'runs'} kept back as a test"
    row = headline_horizon(held_out.get("horizons", []), MODELS)
    if row is None:  # no run is long enough: the error of the next sample
        old, new = (summary["fit"][model].get("test") for model in MODELS)
        if not is_known(old) or not is_known(new):
            return "There was nothing held out to judge it by."
        after = f"{significant(new, 2)} times the noise"
        change = f"goes from {significant(old, 2)} to {after}" if found else f"is {after}"
        return f"{on}, the error of the next sample {change}."
    quantity = known_quantities(row, MODELS)[0]
    old, new = (row[model][quantity] for model in MODELS)
    before, after = (two_digits(value, _QUANTITIES[quantity]) for value in (old, new))
    what = f"{on}, the {quantity} predicted {row['seconds']:g} s ahead is"
    if not found:
        return f"{what} off by {after}."
    if before == after or abs(new - old) < 0.02 * old:
        return f"{what} off by {after} with or without it."
    if new > old:
        return f"{what} off by {after} with what was found, worse than {before} without it."
    return f"{what} off by {after} with what was found, instead of {before}."


WORSE = 1.1  # times an error before, which chance alone hardly gives


def unimproved_sentence(summary: Record) -> str:
    """Where what was found does not improve the predictions of held-out runs, or nothing.

    How far ahead the first quantity that was measured (position, else heading) is predicted no
    better, and how far ahead another one is predicted worse by more than a tenth.
    """
    if not named_effects(summary):
        return ""
    far, worse = [], []
    for row in summary.get("held_out", {}).get("horizons", []):
        ahead = f"{row['seconds']:g} s"
        for number, quantity in enumerate(known_quantities(row, MODELS)):
            old, new = (row[model][quantity] for model in MODELS)
            if number == 0 and new >= old:
                far.append(ahead)
            elif number > 0 and new > WORSE * old:
                change = " -> ".join(two_digits(one, _QUANTITIES[quantity]) for one in (old, new))
                worse.append(f"{quantity} {ahead} ahead ({change})")
    told = []
    if far:
        told.append(
            f"What was found explains single steps, but not the motion {enumeration(far)} ahead: "
            "predictions there are no better with it."
        )
    if worse:
        told.append(f"Predicted worse with it: {enumeration(worse)}.")
    return " ".join(told)


def quick_sentence(not_done: Sequence[str]) -> str:
    """That this was a quick look, and what it has not done; or nothing."""
    if not not_done:
        return ""
    return f"A quick look. Not done: {'; '.join(not_done)}. Without --quick all of it is."


def incomplete_sentence(summary: Record) -> str:
    """That the search ended early, by the time or as a quick look, or nothing."""
    if not_done := summary.get("not_done"):
        return quick_sentence(not_done)
    if summary.get("complete", True):
        return ""
    told = "The time was over before everything had been asked: more may be missing."
    left_out = summary.get("left_out", [])
    return f"{told} Left out: {enumeration(left_out)}." if left_out else told


def sampling_sentence(every: Mapping[str, int] | None) -> str:
    """Of which channels one sample in so many was used, and why; or nothing."""
    if not every:
        return ""
    used = enumeration(
        [f"one sample in {number} of {in_words([name])[0]}" for name, number in every.items()]
    )
    return f"Successive samples err alike, so that only {used} counted."


def straight_sentence(runs: int) -> str:
    """That nothing tells of the turning of so many runs; nothing where there are none."""
    if not runs:
        return ""
    which = "one run" if runs == 1 else f"{runs} runs"
    return f"Nothing tells of drift and turning in {which}, taken as straight ahead."


def remainder_sentence(summary: Record) -> str:
    """What the final model still does not explain, in one sentence."""
    p = summary.get("remainder_p_value")
    if not is_known(p):
        return ""
    if p < SURE_REMAINDER:
        return (
            f"Structure remains in the residuals that the model does not explain ({p_equals(p)})"
            f"{_share_left(summary)}."
        )
    told = f"No significant structure remains in the residuals ({p_equals(p)})"
    if summary["verdict"] == "unexplained":
        return f"{told}, but runs held out are still predicted worse than noise explains."
    return f"{told}."


def _share_left(summary: Record) -> str:
    """How little of the error is left, where it is."""
    row = headline_horizon(summary.get("held_out", {}).get("horizons", []), MODELS)
    if row is None or not named_effects(summary):
        return ""
    quantity = known_quantities(row, MODELS)[0]
    old, new = (row[model][quantity] for model in MODELS)
    if not 0 < new <= LITTLE_LEFT * old:
        return ""
    share = f"{significant(100 * new / old, 2)} %"
    return f"; of the error of {quantity} {row['seconds']:g} s ahead {share} is left"


def misread_sentences(summary: Record) -> list[str]:
    """What the audit says is wrong with how recordings are read, and how to put it right.

    Each once, with the recordings that show it.
    """
    told = []
    for group in alike_findings(filter(is_misread, summary.get("audit") or []), "repair"):
        first, repair = group[0], group[0].get("repair")
        where = first["recording"] if len(group) == 1 else count_recordings(len(group))
        told.append(f"{first['message']} (in {where}){f'. Repair: {repair}' if repair else ''}.")
    return told


def is_misread(finding: Record) -> bool:
    """Whether what is wrong, without a doubt, is how a recording is read."""
    return finding["kind"] in MAPPING_KINDS and not finding.get("doubt")


def alike_findings(found: Iterable[Record], *same: str) -> list[list[Record]]:
    """Findings of the audit, those of one kind on the same channels of several recordings together.

    Arguments:
        same: keys that they must have in common, besides.
    """
    alike: dict[tuple[object, ...], list[Record]] = {}
    for one in found:
        key = one["kind"], *(one.get("channels") or ()), *(one.get(name) for name in same)
        others = [group for known, group in alike.items() if known[:-1] == key]
        where = one["recording"]
        open_ones = [g for g in others if all(other["recording"] != where for other in g)]
        if open_ones:
            open_ones[0].append(one)
        else:
            alike[(*key, len(alike))] = [one]
    return list(alike.values())


def finding_line(group: list[Record]) -> str:
    """What was found in one recording, and the sizes in the others that show it, too."""
    first, sizes = group[0], [one.get("value") for one in group]
    text = f"{as_words(first['kind'])} in {first['recording']}: {first['message']}"
    if len(group) == 1:
        return text
    known = [size for size in sizes if is_known(size)]
    span = ""
    if len(known) == len(group):
        ends = [round_to_error(end(known), None, first.get("unit", "")) for end in (min, max)]
        span = f", {' to '.join(ends)}" if len(set(ends)) > 1 else ""
    return f"{text}; and in {len(group) - 1} more{span}"


def headline_horizon(rows: Sequence[Record], models: Sequence[str]) -> Record | None:
    """The row of errors to quote: 20 s ahead, else the longest horizon that there is."""
    rows = [row for row in rows if known_quantities(row, models)]
    preferred = [row for row in rows if row["seconds"] == HEADLINE_SECONDS]
    return (preferred or rows[-1:] or [None])[0]


def known_quantities(row: Record, models: Sequence[str]) -> list[str]:
    """Position and heading, as far as all models have an error of them."""
    return [one for one in _QUANTITIES if all(is_known(row[model].get(one)) for model in models)]


def horizon_line(row: Record, models: Sequence[str]) -> str:
    """`20 s ahead: position 3.9 m -> 0.5 m, heading 12 deg -> 1.1 deg`, and what diverged.

    Arguments:
        row: of `comparison.horizon_table`.
        models: keys of the row, the result last.
    """
    parts = []
    for quantity in known_quantities(row, models):
        errors = [two_digits(row[model][quantity], _QUANTITIES[quantity]) for model in models]
        parts.append(f"{quantity} {' -> '.join(errors)}")
    ahead, diverged = f"{row['seconds']:g} s ahead", diverged_predictions(row, models)
    if parts:
        return f"{ahead}: {', '.join(parts)}{diverged}"
    return f"{ahead}: nothing to compare{diverged}" if diverged else ""


def diverged_predictions(row: Record, models: Sequence[str]) -> str:
    """` (3 -> 0 of 20 diverge)` where predictions of any model do, whose errors are not counted."""
    counts = [int(row[model].get("diverged", 0)) for model in models]
    said = " -> ".join(map(str, counts))
    return f" ({said} of {row['starts']} diverge)" if any(counts) else ""


def two_digits(value: float, unit: str) -> str:
    """An error with two significant digits."""
    return round_to_error(value, 0.1 * abs(value), unit)


def strongest_places(summary: Record, count: int = 3) -> list[str]:
    """Where the mismatch is, one line for each degree of freedom, strongest first.

    A window of one recording is named before a regime of all of them.
    """
    by_degree: dict[str, list[Record]] = {}
    for cell in summary["where"]:
        by_degree.setdefault(cell["degree_of_freedom"], []).append(cell)
    lines = []
    for degree, cells in by_degree.items():
        cell = next((c for c in cells if c["recording"] != "all"), cells[0])
        where = f"{cell['recording']} from {cell['start']:.0f} to {cell['end']:.0f} s"
        where = "all runs" if cell["recording"] == "all" else where
        regime = f", {cell['regime']}" if cell.get("in_regime", True) else ""
        force = f"{significant(cell['force_rms'], 2)} {cell['unit']}"
        lines.append(f"{degree}, {where}{regime} (about {force})")
    return lines[:count]


def single_step_sentence(summary: Record) -> str:
    """Names that were refused because free predictions of the motion get worse with them."""
    refused = [row for row in summary.get("candidates", []) if row.get("predicts_motion") is False]
    names = list(dict.fromkeys(as_words(row["name"]) for row in refused))
    if not names:
        return ""
    verb = "explains" if len(names) == 1 else "explain"
    return (
        f"{capital(enumeration(names))} {verb} single steps, but not the motion: no name is given."
    )


def parameter_words(name: str) -> str:
    """A parameter of an effect: symbols with their meaning, `Y_ur (sway force from u r)`."""
    meaning = SYMBOLS.get(name) or parameter_meaning(name)
    words = name.replace("_", " ")
    return words if meaning == words else f"{name} ({meaning})"


def parameter_lines(effect: Record) -> list[str]:
    """`speed 0.301 +- 0.004 m/s` for each parameter of an effect.

    One of which data only say that it is no smaller reads `rate limit above 90 N/s, if any`.
    """
    lines = []
    for name, entry in effect["parameters"].items():
        text = with_error(entry["value"], entry.get("std"), entry.get("unit", ""))
        if "beyond" in entry:
            text = f"above {round_to_error(entry['beyond'], None, entry['unit'])}, if any"
        lines.append(f"{parameter_words(name)} {text}{direction_note(effect, name)}")
    return lines


def effect_lines(name: str, runs: Sequence[Record], log10_odds: float | None = None) -> list[str]:
    """A fitted effect in a line, or in one line for each recording.

    Arguments:
        name: in the registry, `rate-limit:propulsion`.
        runs: parameters by name, each with `value`, `std` and `unit`, for each recording.
        log10_odds: decimal logarithm of its odds against none, where it is known.
    """
    sure = "" if log10_odds is None else f"; odds against none {odds(log10_odds)}"
    lines = []
    for number, parameters in enumerate(runs, start=1):
        sizes = ", ".join(parameter_lines({"name": name, "parameters": parameters}))
        where = f", recording {number}" if len(runs) > 1 else ""
        lines.append(f"{as_words(name).replace(':', ', ')}{where}: {sizes}{sure}")
    return lines


def together_note(effect: Record) -> str:
    """That several parameters are needed, but only together, where no size stands by itself."""
    entries = effect["parameters"].values()
    sizes = [(one["value"], one.get("std")) for one in entries if "beyond" not in one]
    open_ones = [is_known(v) and is_known(s) and abs(v) < 2 * s for v, s in sizes]
    return (
        " (needed together, none determined by itself)" if len(sizes) > 1 and all(open_ones) else ""
    )


def direction_note(effect: Record, parameter: str) -> str:
    """Whether a direction is where something flows to or comes from."""
    entry = catalogue_entry(effect)
    form = None if entry is None else entry.parametrisation
    note = "" if form is None else form.notes.get(parameter, "")
    return f" ({note})" if note else ""


def verdict_text(summary: Record) -> str:
    """The diagnosis in a few lines for the terminal.

    Arguments:
        summary: the content of diagnosis.json.
    """
    named = named_effects(summary)
    rows = summary.get("held_out", {}).get("horizons", [])
    others = [one for one in summary["audit"] if not is_misread(one)]
    audit = [finding_line(group) for group in alike_findings(others, "unit")[:LISTED_FINDINGS]]
    what = []
    for effect in named:
        place = f" in {effect['recording']}" if "recording" in effect else ""
        acts_on = acted_on(effect)
        size = effect.get("evidence", {}).get("log10_odds")
        sure = f"; odds {odds_or_bound(size)}" if is_known(size) else ""
        sizes = ", ".join(parameter_lines(effect)) + together_note(effect)
        what.append(f"{as_words(effect['name'])}{acts_on}{place}: {sizes}{sure}")
    following, proposal = "", summary.get("next_experiment")
    if proposal:
        manoeuvre, seconds = "no manoeuvre", proposal.get("seconds")
        if is_known(seconds):
            manoeuvre = f"{as_words(proposal['manoeuvre'])} for {duration(seconds)}"
        following = f"{manoeuvre}: {proposal['why']}"
    places = strongest_places(summary)
    items = {
        "where": ["without what was found:"] * bool(named and places) + places,
        "what": what,
        "error": [
            *(horizon_line(row, MODELS if named else MODELS[1:]) for row in rows),
            unimproved_sentence(summary),
        ],
        "left": [
            remainder_sentence(summary),
            single_step_sentence(summary),
            incomplete_sentence(summary),
        ],
        "data": [
            *audit,
            sampling_sentence(summary.get("one_sample_in")),
            straight_sentence(summary.get("straight_runs", 0)),
        ],
        "next": [following],
    }
    misread = [f"Misread: {one}" for one in misread_sentences(summary)]
    head = [prediction_sentence(summary), *misread, verdict_sentence(summary)]
    lines = [line for text in head for line in textwrap.wrap(text, LINE_WIDTH)] + [""]
    wrapper = textwrap.TextWrapper(LINE_WIDTH, subsequent_indent=" " * LABEL_WIDTH)
    for label, texts in items.items():
        for text in filter(None, texts):
            wrapper.initial_indent = f"{label:<{LABEL_WIDTH}}"
            lines += wrapper.wrap(text)
            label = ""
    return "\n".join(lines).rstrip()
