"""A diagnosis as one page for people: verdict, where, what, how large, before and after.

Effects with their sizes, candidates and rivals, what could not be seen: what is missing, and how
sure that is.
"""

import dataclasses
import math
import textwrap
from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
import plotly.graph_objects as go
from markupsafe import Markup

from diffsea.identification.holdout import HeldOut, Split
from diffsea.report.location import location_section
from diffsea.report.page import (
    Cell,
    Plot,
    Table,
    Verbatim,
    odds_cell,
    parameter_table,
    probability_cell,
    provenance,
    render,
    typeset_unless_verbatim,
)
from diffsea.report.plots import CURSOR, DIAGNOSED, MEASURED, NOMINAL, figure
from diffsea.report.predictions import ComparedRun, prediction_section
from diffsea.report.quantities import (
    duration,
    interval,
    is_known,
    odds,
    round_to_error,
    significant,
    typeset,
    with_error,
)
from diffsea.report.tracks import DrawnFlow
from diffsea.report.wording import caveats, findings, verdicts, words
from diffsea.report.wording.words import Record


# Colour and hatching of bars by what became of the candidate.
STATUS = {
    "accepted": (DIAGNOSED, ""),
    "rival": (NOMINAL, "/"),
    "rejected": (MEASURED, ""),
    "screened out": ("#ffffff", ""),
}
SHOWN_CANDIDATES = 10  # the others are folded away
DECISIVE = 2 * math.log(1000.0)  # twice the log of odds of 1000 to 1
_OF_EVIDENCE = ("log10_odds", "p_value", "held_out_gain", "held_out_gain_std")
NORMAL_90 = 1.6449  # standard errors to either side that hold 90 % of a normal distribution
ODDS_TICKS = (-100, -10, -3, 0, 3, 10, 30, 100, 300, 1000)  # decimal logarithms
BAR_ROOM = 1.05  # of the axis over the longest bar
LABEL_WIDTH = 18  # characters of a candidate's name beside its bar, for a phone
TICK_DISTANCE = 0.2  # of the axis, so that labels do not touch
PAGE_NUMBERS = 140_000  # in all plots, some six characters each, beside the library's 5 MB
NUMBERS_PER_ROW = (27, 43)  # for a row of a recording, and of a held-out run with two models
LARGEST_RUN, SMALLEST_RUN = 1500, 50  # rows: more cannot be told apart, fewer are no curve


def diagnosis_report(
    summary: Record, vessel_name: str, split: Split, runs: Sequence[ComparedRun], source: Record
) -> str:
    """The page.

    Arguments:
        summary: the content of diagnosis.json.
        split: recordings that were fitted and those held out.
        runs: those held out and what both models predict of them.
        source: what was run on what: file names, hashes, settings; shown as it is.
    """
    recordings, held_out = split.recordings, split.held_out
    by_time = split.kind is HeldOut.LAST_PARTS
    numbers = NUMBERS_PER_ROW[0] * len(recordings) + NUMBERS_PER_ROW[1] * len(held_out)
    most = min(LARGEST_RUN, max(SMALLEST_RUN, PAGE_NUMBERS // max(numbers, 1)))
    kept_back = "the last part of each" if by_time else f"{len(held_out)} more"
    models = {"nominal": "nominal", "diagnosed": "diagnosed"}
    if not words.named_effects(summary):
        models = {"diagnosed": "predicted"}
    subtitle = f"{words.count_recordings(len(recordings))}, {kept_back} held out"
    if earlier := source.get("reference"):
        subtitle += f"; what changed since {words.count_recordings(len(earlier))} of reference"
    used = [(run, "fitted") for run in recordings]
    used += [] if by_time else [(run, "held out") for run in held_out]
    null = summary["null"]
    found = []
    for finding in findings.heaviest_first(summary["audit"]):
        size = ""
        if is_known(finding.get("value")):
            size = with_error(finding["value"], finding.get("std"), finding.get("unit", ""))
        texts = [Verbatim(finding["message"])]
        if finding.get("repair"):
            texts.append(Verbatim(f"Repair: {finding['repair']}"))
        what = words.as_words(finding["kind"]), Verbatim(finding["recording"])
        found.append([*what, size, findings.cost_words(finding.get("cost")), texts])
    columns = ["fault", "recording", "size", "cost in a minute", "what was seen"]
    chance = {key: null[key] for key in ("draws", "alpha")}
    chance["threshold"] = significant(null["threshold"], 2)
    method = {"significance from simulated data without effects": chance}
    if "bootstrap" in null:
        method["the same, every simulated data set fitted anew"] = null["bootstrap"]
    predictions = prediction_section(runs, models, most, None, flows(summary))
    picture, predictions = predictions.without_first_track()
    return render(
        "diagnosis.html.j2",
        bundle="cartesian",
        title=f"Diagnosis of {vessel_name}",
        subtitle=subtitle,
        verdict=summary["verdict"],
        in_part=summary["verdict"] == "unexplained" and bool(words.named_effects(summary)),
        misread=findings.misread_sentences(summary),
        finding=verdicts.verdict_sentence(summary),
        prediction_change=verdicts.prediction_sentence(summary),
        unimproved=verdicts.unimproved_sentence(summary),
        remainder=verdicts.remainder_sentence(summary),
        incomplete=caveats.incomplete_sentence(summary),
        sampling=" ".join(
            (
                caveats.sampling_sentence(summary["one_sample_in"]),
                caveats.straight_sentence(summary["straight_runs"]),
                *caveats.side_sentences(summary["sides"]),
            )
        ).strip(),
        location=location_section(summary, recordings, most),
        effects=found_effects(summary),
        ranking=candidate_ranking(summary),
        own_environment=any("recording" in effect for effect in summary["effects"]),
        picture=picture,
        predictions=predictions,
        next=next_experiment_section(summary),
        unseen=unseen_table(summary),
        parameters=parameter_table(summary["parameters"]),
        faults=len(found),
        fault_table=Table(columns, found, f"Findings of the audit. {findings.WEIGHED}"),
        provenance=provenance(source | method, used),
    )


def flows(summary: Record) -> list[DrawnFlow]:
    """Current and wind that were named with one size for all recordings, to be drawn as arrows.

    Arguments:
        summary: the content of diagnosis.json.
    """
    found = []
    for effect in words.named_effects(summary):
        sizes = effect["parameters"]
        if effect["name"] not in ("current", "wind") or "recording" in effect:
            continue
        if not {"speed", "direction"} <= set(sizes):
            continue
        comes_from = effect["name"] == "wind"
        speed = round_to_error(sizes["speed"]["value"], sizes["speed"].get("std"), "m/s")
        towards = sizes["direction"]["value"] + math.pi * comes_from
        found.append(DrawnFlow(f"{effect['name']} {speed}", towards))
    return found


@dataclasses.dataclass(frozen=True)
class FoundEffect:
    """An effect that was added to the model: its sizes, and sentences of what speaks for it."""

    title: str
    sizes: Table
    evidence: Sequence[str]


@dataclasses.dataclass(frozen=True)
class Ranking:
    """All candidates, best first.

    Attributes:
        odds: None where none has odds.
        key: fill of the bars, as CSS, by status.
    """

    odds: Plot | None
    key: Mapping[str, str]
    best: Table
    weaker: Table


@dataclasses.dataclass(frozen=True)
class NextExperiment:
    """Rivals that the data cannot tell apart, and the manoeuvre that would tell.

    Attributes:
        rivals: a sentence for each effect.
        candidates: rivals of the catalogue with their reasons.
        advice: empty where no manoeuvre is proposed.
        evidence: what each manoeuvre of the library would tell.
    """

    rivals: Sequence[str]
    candidates: Sequence[str]
    advice: str
    evidence: Plot | None


def found_effects(summary: Record) -> list[FoundEffect]:
    """The effects found, with sizes and 90 % intervals; one of each recording's own as one.

    Arguments:
        summary: the content of diagnosis.json.
    """
    out = []
    for group in words.effect_groups(words.named_effects(summary)):
        first = group[0]
        own = "recording" in first
        rows: list[list[Cell]] = []
        for effect in group:
            for name, entry in effect["parameters"].items():
                label = words.parameter_words(name) + words.direction_note(effect, name)
                size = with_error(entry["value"], entry.get("std"), entry.get("unit", ""))
                place = [Verbatim(effect["recording"])] if own else []
                rows.append([*place, label, size, interval_of(entry)])
                if within := words.within_recording(entry):
                    rows.append([*place, "which is", Verbatim(within), ""])
        columns = [*(["recording"] if own else []), "parameter", "estimate", "90 % interval"]
        title, known = words.as_words(first["name"]) + words.acted_on(first), first["evidence"]
        gain = with_error(known.get("held_out_gain"), known.get("held_out_gain_std"))
        removed = 100 * (known.get("cost_drop") or 0.0)
        against_none, next_best = (
            odds_cell(known.get(key)) for key in ("log10_odds", "log10_odds_next")
        )
        chance = probability_cell(known.get("p_value"))
        sentences = {
            "log10_odds": ("Odds in favour, against no effect: {}.", against_none),
            "log10_odds_next": ("Odds in favour, against the next best name: {}.", next_best),
            "p_value": ("p, if nothing were missing: {}.", chance),
            "cost_drop": (
                "It removes {} of the squared prediction errors.",
                f"{round(removed)} %",
            ),
            "held_out_gain": ("Held-out gain in -2 log likelihood: {}.", gain),
        }
        evidence = [
            Markup(typeset(text)).format(typeset_unless_verbatim(value))
            for key, (text, value) in sentences.items()
            if is_known(known.get(key))
        ]
        out.append(FoundEffect(title, Table(columns, rows), evidence))
    return out


def interval_of(entry: Record) -> str:
    """The central 90 % interval of a size, by its standard error where it has none itself."""
    value, std = entry.get("value"), entry.get("std")
    bounds = entry.get("interval")
    if bounds is None and is_known(value) and is_known(std) and std > 0:
        bounds = (value - NORMAL_90 * std, value + NORMAL_90 * std)
    return "not known" if bounds is None else interval(bounds, entry.get("unit", ""))


def candidate_ranking(summary: Record) -> Ranking:
    """Every candidate, as bars and as a table.

    First comes what became of a candidate, accepted before rival before rejected, then its odds.

    Arguments:
        summary: the content of diagnosis.json.
    """
    places = {status: k for k, status in enumerate(STATUS)}

    def order(one: Record) -> tuple[int, float]:
        size = one.get("log10_odds")
        place = places.get(one.get("status", ""), len(places))
        return place, -size if is_known(size) else math.inf

    candidates = [_as_found(one, summary) for one in summary["candidates"]]
    ranked = sorted(candidates, key=order)
    weighed = [
        (candidate_label(one), one.get("status", ""), float(one["log10_odds"]))
        for one in ranked
        if is_known(one.get("log10_odds"))
    ][:SHOWN_CANDIDATES]
    key = {}
    for status, (colour, hatched) in STATUS.items():
        if status in {status for _, status, _ in weighed}:
            hatching = f"repeating-linear-gradient(135deg, {colour} 0 2px, #fff 2px 5px)"
            key[status] = hatching if hatched else colour
    texts = ", ".join(f"{name} {typeset(odds(size))} ({status})" for name, status, size in weighed)
    height = 60 + 32 * len(weighed)
    plot = Plot(odds_plot(weighed), f"Odds of candidates: {texts}.", height) if weighed else None
    columns = ["candidate", "status", "odds", "p", "held-out gain", "size, 90 % interval", "why"]
    rows = [_candidate_row(one) for one in ranked]
    best, weaker = rows[:SHOWN_CANDIDATES], rows[SHOWN_CANDIDATES:]
    numeric = (2, 3, 4)
    return Ranking(
        plot, key, Table(columns, best, numeric=numeric), Table(columns, weaker, numeric=numeric)
    )


def _as_found(candidate: Record, summary: Record) -> Record:
    """A candidate that was accepted with the numbers that it has in the final model.

    A page says each number once: by itself a candidate has slightly others than beside the rest.
    """
    if candidate.get("status") != "accepted":
        return candidate
    same = [
        effect
        for effect in words.named_effects(summary)
        if (effect["name"], words.acted_on(effect))
        == (candidate["name"], words.acted_on(candidate))
    ]
    if len(same) != 1:
        return candidate
    evidence = same[0]["evidence"]
    known = {key: evidence[key] for key in _OF_EVIDENCE if is_known(evidence.get(key))}
    return candidate | known | {"parameters": same[0]["parameters"]}


def candidate_label(candidate: Record) -> str:
    """A candidate with what tells it from others of its name: `added mass coupling (Y rdot)`."""
    variant = candidate.get("variant", "").replace("_", " ")
    terms = f" ({variant})" if variant else ""
    return words.as_words(candidate["name"]) + terms + words.acted_on(candidate)


def _candidate_row(one: Record) -> list[str]:
    """A row of the ranking; what was not computed stays empty."""
    gain, size, p = one.get("held_out_gain"), one.get("log10_odds"), one.get("p_value")
    sizes = [
        f"{words.parameter_words(name)} {interval_of(entry)}"
        for name, entry in (one.get("parameters") or {}).items()
    ]
    return [
        candidate_label(one),
        one.get("status", "").replace(" ", "\u00a0"),
        odds_cell(size) if is_known(size) else "",
        probability_cell(p) if is_known(p) else "",
        with_error(gain, one.get("held_out_gain_std")) if is_known(gain) else "",
        "; ".join(sizes),
        one.get("reason", ""),
    ]


def next_experiment_section(summary: Record) -> NextExperiment:
    """Rivals that the data cannot tell apart, and the manoeuvre that would tell.

    Arguments:
        summary: the content of diagnosis.json.
    """
    sentences = []
    for effect, *_ in words.effect_groups(words.named_effects(summary)):
        rivals = [words.as_words(name) for name in effect.get("alternatives", [])]
        others = "nothing else in the catalogue explains the data nearly as well"
        if rivals:
            others = f"the same data support {words.enumeration(rivals, 'or')} nearly as well"
        sentences.append(f"{words.capital(words.as_words(effect['name']))}: {others}.")
    candidates = [
        f"{candidate_label(one)}: {one.get('reason') or 'a rival'}"
        for one in summary["candidates"]
        if one.get("status") == "rival"
    ]
    proposal = summary["next_experiment"]
    if not proposal:
        return NextExperiment(sentences, candidates, "", None)
    advice = f"There is no manoeuvre to record next: {proposal['why']}."
    if is_known(proposal.get("seconds")):
        what = f"Record next: {words.as_words(proposal['manoeuvre'])}. It {proposal['why']}"
        advice = f"{what}; for odds of 1000 : 1 it must run for {duration(proposal['seconds'])}."
    evidence = {k: v for k, v in (proposal.get("evidence") or {}).items() if is_known(v)}
    plot = None
    if evidence:
        texts = ", ".join(f"{name} {significant(value, 2)}" for name, value in evidence.items())
        caption = "What a run of each manoeuvre in the library would tell, all of the same length."
        height = 90 + 24 * len(evidence)
        plot = Plot(manoeuvre_plot(evidence), f"Expected evidence: {texts}.", height, caption)
    return NextExperiment(sentences, candidates, advice, plot)


def unseen_table(summary: Record) -> Table:
    """The smallest effect of each candidate that these data could have shown.

    What is invisible at any size comes first: it is easily taken for absent.
    """
    limits = summary["detection_limits"]
    plain = Counter(words.as_words(one["name"]) + words.acted_on(one) for one in limits)
    rows = []
    for one in sorted(limits, key=lambda one: is_known(one.get("limit"))):
        size, limit = "not at any plausible size", one.get("limit")
        if is_known(limit):
            size = round_to_error(abs(limit), 0.1 * abs(limit), one.get("unit", ""))
        name = words.as_words(one["name"]) + words.acted_on(one)
        name = candidate_label(one) if plain[name] > 1 else name
        parameter = words.parameter_words(str(one.get("parameter") or ""))
        rows.append([name, parameter, size, one.get("note") or ""])
    return Table(["candidate", "parameter", "smallest size that would show", "note"], rows)


def odds_plot(candidates: Sequence[tuple[str, str, float]]) -> go.Figure:
    """Candidates (name, status, decimal logarithm of the odds) as bars, in the order given.

    Bars are as long as the logarithm of the logarithm beyond odds of about ten, so that an
    effect beyond doubt leaves room for those in doubt.
    """

    def label(name: str) -> str:
        return "<br>".join(textwrap.wrap(name, LABEL_WIDTH))

    margin = {"t": 8, "l": 8, "r": 12, "b": 40}
    drawn = figure(bargap=0.35, barmode="overlay", showlegend=False, margin=margin)
    for status, (colour, pattern) in STATUS.items():
        own = [one for one in candidates if one[1] == status]
        if own:
            outline = {"color": MEASURED, "width": 1}
            drawn.add_bar(
                orientation="h",
                name=status,
                y=[label(name) for name, _, _ in own],
                x=[_stretch(size) for _, _, size in own],
                text=[typeset(odds(size)) for _, _, size in own],
                textposition="none",
                marker={"color": colour, "pattern": {"shape": pattern}, "line": outline},
                hovertemplate="%{y}: odds %{text}",
            )
    sizes = [size for _, _, size in candidates]
    low, high = min([*sizes, 0.0]), max([*sizes, 3.0])
    apart = TICK_DISTANCE * (_stretch(high) - _stretch(low))
    ticks = [0.0]  # and those that leave room for their labels
    for tick in sorted(ODDS_TICKS, key=abs):
        if low <= tick <= high and min(abs(_stretch(tick) - _stretch(t)) for t in ticks) > apart:
            ticks.append(tick)
    ticks.sort()
    drawn.update_xaxes(
        title={"text": "odds in its favour"},
        tickvals=[_stretch(tick) for tick in ticks],
        ticktext=[typeset(odds(tick).removesuffix(" : 1")).removeprefix("1×") for tick in ticks],
        tickangle=0,
        range=[BAR_ROOM * _stretch(low), BAR_ROOM * _stretch(high)],
    )
    names = [label(name) for name, _, _ in candidates]
    return drawn.update_yaxes(categoryorder="array", categoryarray=names[::-1], fixedrange=True)


def _stretch(size: float) -> float:
    """Where odds lie on the axis, by the decimal logarithm of them: sign(s) log10(1 + |s|)."""
    return float(np.sign(size) * np.log10(1 + abs(size)))


def manoeuvre_plot(evidence: Mapping[str, float]) -> go.Figure:
    """Expected evidence of each manoeuvre, the best on top, beside what would be decisive.

    Arguments:
        evidence: twice the natural logarithm of the odds, by manoeuvre.
    """
    ranked = sorted(evidence, key=lambda name: evidence[name])
    values = [evidence[name] for name in ranked]
    bars = go.Bar(
        orientation="h",
        y=[words.as_words(name) for name in ranked],
        x=values,
        text=[typeset(significant(value, 2)) for value in values],
        textposition="auto",
        marker={"color": [*[MEASURED] * (len(ranked) - 1), DIAGNOSED]},
        hovertemplate="%{y}: %{text}<extra></extra>",
    )
    axis = {"title": {"text": "expected 2 ln(odds)"}}
    margin = {"t": 28, "l": 8, "r": 12, "b": 40}
    drawn = figure(bars, margin=margin, bargap=0.3, xaxis=axis)
    drawn.add_vline(
        x=DECISIVE,
        line={"color": CURSOR, "width": 1.5, "dash": "dot"},
        annotation={"text": "odds 1000 : 1", "yanchor": "bottom", "y": 1.0},
    )
    return drawn.update_yaxes(fixedrange=True)
