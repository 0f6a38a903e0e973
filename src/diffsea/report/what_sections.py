"""The sections of a diagnosis that say *what* is missing, what would tell more, and what
could not have been seen."""

import math
from collections.abc import Sequence

from diffsea.report import words as words
from diffsea.report.evidence_plots import STATUS, manoeuvre_plot, odds_plot
from diffsea.report.interactive import plot
from diffsea.report.page import (
    Content,
    Html,
    bullets,
    element,
    folded,
    joined,
    paragraph,
    section,
    table,
    verbatim,
)
from diffsea.report.quantities import (
    duration,
    interval,
    known,
    odds,
    probability,
    rounded,
    significant,
    typeset,
    with_error,
)


_ROWS = 10
_DECISIVE = 2 * math.log(1000.0)  # twice the log of odds of 1000 to 1
_NORMAL = 1.6449  # standard errors to either side that hold 90 %


def what_section(result: dict) -> Html:
    """The effects found, with sizes, intervals and odds, and the ranking of all candidates."""
    found = words.accepted(result)
    parts: list[Content] = []
    if not found:
        parts.append(paragraph("No effect of the catalogue was added to the model."))
    parts += [_effect(group) for group in words.grouped(found)]
    parts.append(_ranking(result))
    return section("what", "What is missing, and how large is it?", *parts)


def _effect(group: list[dict]) -> Html:
    first = group[0]
    own = "recording" in first
    rows = [
        [
            *([verbatim(effect["recording"])] if own else []),
            name.replace("_", " ") + words.direction_note(effect, name),
            with_error(entry["value"], entry.get("std"), entry.get("unit", "")),
            _interval(entry),
        ]
        for effect in group
        for name, entry in effect["parameters"].items()
    ]
    columns = [*(["recording"] if own else []), "parameter", "estimate", "90 % interval"]
    heading = element("h3", words.title(first["name"]) + _of(first))
    return joined([heading, table(columns, rows), bullets(_evidence(first))])


def _of(record: dict) -> str:
    """What an effect acts on, where it has a choice."""
    names = [*(record.get("channels") or []), *(record.get("actuators") or [])]
    return f" of {', '.join(names)}" if names else ""


def _interval(entry: dict) -> str:
    value, std = entry.get("value"), entry.get("std")
    bounds = entry.get("interval")
    if bounds is None and known(value) and known(std) and std > 0:
        bounds = (value - _NORMAL * std, value + _NORMAL * std)
    return "not known" if bounds is None else interval(bounds, entry.get("unit", ""))


def _evidence(effect: dict) -> list[str]:
    evidence = effect["evidence"]
    lines = []
    if known(evidence.get("log10_odds")):
        lines.append(f"Odds in favour, against no effect: {odds(evidence['log10_odds'])}.")
    if known(evidence.get("log10_odds_next")):
        lines.append(
            f"Odds in favour, against the next best name: {odds(evidence['log10_odds_next'])}."
        )
    if known(evidence.get("p_value")):
        lines.append(f"p = {probability(evidence['p_value'])} if nothing were missing.")
    if known(evidence.get("cost_drop")):
        share = f"{100 * evidence['cost_drop']:.0f} %"
        lines.append(f"It removes {share} of the squared prediction errors.")
    gain = evidence.get("held_out_gain")
    if known(gain):
        std = evidence.get("held_out_gain_std")
        lines.append(f"Held-out gain in -2 log likelihood: {with_error(gain, std)}.")
    return lines


def _ranking(result: dict) -> Html:
    heading = element("h3", "Ranking of candidates")
    candidates = result.get("candidates")
    if not candidates:
        return joined([heading, paragraph("A ranking with odds was not computed.")])
    ranked = sorted(candidates, key=_rank)
    weighed = [
        (_label(one), one.get("status", ""), float(one["log10_odds"]))
        for one in ranked
        if known(one.get("log10_odds"))
    ][:_ROWS]
    text = (
        "Every effect of the catalogue that this vessel could have. The odds in its favour say how "
        "much better the recordings are explained with it than without any effect."
    )
    columns = ["candidate", "status", "odds", "p", "held-out gain", "size, 90 % interval", "why"]
    rows = [_row(one) for one in ranked]
    more = table(columns, rows[_ROWS:], numeric=(2, 3, 4))
    return joined(
        [
            heading,
            paragraph(text, "note"),
            _odds(weighed) if weighed else "",
            table(columns, rows[:_ROWS], numeric=(2, 3, 4)),
            folded(f"{len(rows) - _ROWS} weaker candidates", more) if rows[_ROWS:] else "",
        ]
    )


def _rank(candidate: dict) -> tuple[int, float]:
    status = candidate.get("status", "")
    size = candidate.get("log10_odds")
    place = {name: k for k, name in enumerate(STATUS)}.get(status, len(STATUS))
    return place, -size if known(size) else math.inf


def _label(candidate: dict) -> str:
    variant = candidate.get("variant", "").replace("_", " ")
    return words.title(candidate["name"]) + (f" ({variant})" if variant else "") + _of(candidate)


def _odds(weighed: Sequence[tuple[str, str, float]]) -> Html:
    told = ", ".join(f"{name} {typeset(odds(size))} ({status})" for name, status, size in weighed)
    drawn = odds_plot(weighed)
    return joined(
        [_key(weighed), plot(drawn, f"Odds of candidates: {told}.", 60 + 32 * len(weighed))]
    )


def _key(weighed: Sequence[tuple[str, str, float]]) -> Html:
    """What the colours of the bars say."""
    used = {status for _, status, _ in weighed}
    entries = []
    for status, (colour, hatched) in STATUS.items():
        if status in used:
            fill = f"repeating-linear-gradient(135deg, {colour} 0 2px, #fff 2px 5px)"
            look = fill if hatched else colour
            swatch = f'<i class="small" style="background:{look}"></i>'
            entries.append(f"<span>{swatch}{status}</span>")
    return Html(f'<div class="key">{"".join(entries)}</div>')


def _row(one: dict) -> list[Content]:
    gain = one.get("held_out_gain")
    sizes = [
        f"{name.replace('_', ' ')} {_interval(entry)}"
        for name, entry in (one.get("parameters") or {}).items()
    ]
    size = one.get("log10_odds")
    return [
        _label(one),
        one.get("status", "").replace(" ", "\u00a0"),
        odds(size) if known(size) else "",
        probability(one["p_value"]) if known(one.get("p_value")) else "",
        with_error(gain, one.get("held_out_gain_std")) if known(gain) else "",
        "; ".join(sizes),
        one.get("reason", ""),
    ]


def next_section(result: dict) -> Html:
    """Rivals that the data cannot tell apart, and the manoeuvre that would tell."""
    parts: list[Content] = []
    for group in words.grouped(words.accepted(result)):
        parts.append(paragraph(_rivals(group[0])))
    rivals = [one for one in result.get("candidates") or [] if one.get("status") == "rival"]
    if rivals:
        lines = [f"{_label(one)}: {one.get('reason') or 'a rival'}" for one in rivals]
        parts.append(bullets(lines))
    proposal = result.get("next_experiment")
    if not proposal:
        parts.append(paragraph("No further manoeuvre is proposed."))
        return section("next", "What else would explain it, and what to record next", *parts)
    parts.append(paragraph(_proposal(proposal), "advice"))
    evidence = {k: v for k, v in (proposal.get("evidence") or {}).items() if known(v)}
    if evidence:
        text = "What a run of each manoeuvre in the library would tell, all of the same length."
        told = ", ".join(f"{name} {significant(v, 2)}" for name, v in evidence.items())
        drawn = manoeuvre_plot(evidence, _DECISIVE)
        height = 90 + 24 * len(evidence)
        parts.append(plot(drawn, f"Expected evidence: {told}.", height, text))
    return section("next", "What else would explain it, and what to record next", *parts)


def _rivals(effect: dict) -> str:
    rivals = [words.title(name) for name in effect.get("alternatives", [])]
    name = words.capital(words.title(effect["name"]))
    if not rivals:
        return f"{name}: nothing else in the catalogue explains the data nearly as well."
    return f"{name}: the same data support {words.listed(rivals, 'or')} nearly as well."


def _proposal(proposal: dict) -> str:
    seconds = proposal.get("seconds")
    if not known(seconds):
        return f"There is no manoeuvre to record next: {proposal['why']}."
    what = f"Record next: {words.title(proposal['manoeuvre'])}. It {proposal['why']}"
    return f"{what}; for odds of 1000 : 1 it must run for {duration(seconds)}."


def unseen_section(result: dict) -> Html:
    """The smallest effect of each candidate that these data could have shown."""
    heading = "What could not have been seen?"
    limits = result.get("detection_limits")
    if limits is None:
        return section("unseen", heading, paragraph("Detection limits were not computed."))
    if not limits:
        return section("unseen", heading, paragraph("Every candidate was found."))
    text = (
        "Of what was not found, the smallest size that these recordings would have shown. "
        "Anything smaller may be there."
    )
    # What is invisible at any size comes first: it is easily taken for absent.
    ordered = sorted(limits, key=lambda one: known(one.get("limit")))
    rows = [
        [
            words.title(one["name"].replace(":", ", ").replace("_", " ")),
            str(one.get("parameter") or "").replace("_", " "),
            rounded(abs(one["limit"]), 0.1 * abs(one["limit"]), one.get("unit", ""))
            if known(one.get("limit")) else "not at any plausible size",
            one.get("note") or "",
        ]
        for one in ordered
    ]  # fmt: skip
    columns = ["candidate", "parameter", "smallest size that would show", "note"]
    return section("unseen", heading, paragraph(text), table(columns, rows))
