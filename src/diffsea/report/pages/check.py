"""A log's check as one page for people: content, soundness, trials, answers, open questions."""

import itertools
import math
from collections.abc import Mapping, Sequence
from statistics import NormalDist
from typing import Any

import numpy as np
import plotly.graph_objects as go

from diffsea.channels import steers
from diffsea.checks import Answers, LogCheck, PooledCheck
from diffsea.checks.answers import SteadyPoint
from diffsea.checks.lags import FirstOrderLag
from diffsea.checks.open_questions import OpenQuestion
from diffsea.checks.shares import OrderScale
from diffsea.checks.spans import LEVEL, IntervalEstimate
from diffsea.recordings import Finding
from diffsea.report.page import Plot, Table, Verbatim, provenance, render
from diffsea.report.plots import (
    DIAGNOSED,
    MEASURED,
    NOMINAL,
    TRACK_LAYOUT,
    add_time_cursor,
    add_track_markers,
    evenly,
    figure,
    numbers,
)
from diffsea.report.quantities import duration, for_people, round_to_error, significant
from diffsea.report.wording.findings import WEIGHED, cost_words, heaviest_first
from diffsea.report.wording.words import Record, capital, enumeration
from diffsea.scales import HARD_OVER
from diffsea.trajectory import in_words


DRAWN_ROWS = 1500  # of a run: more cannot be told apart
DRAWN_SAMPLES = 800  # behind the points of a curve
LEAST_RATIO = 0.015  # of sides, 3 % between them: no answer is of first order to less than that
MOST_ALIKE = 5.0  # per cent within which sides that are not told apart are said to be alike
LEAST_AHEAD = 0.05  # of full order, from which on a speed is worth a sentence
ROW_HEIGHT = 26  # pixels, of a channel in the picture of quality
COLOURS = {  # of trials, told apart with any kind of colour vision
    "turning": DIAGNOSED,
    "zigzag": NOMINAL,
    "coasting": "#cc79a7",
    "straight": "#56b4e9",
}
SOUND, DOUBTFUL, IDLE = DIAGNOSED, NOMINAL, "rgba(138,150,163,0.35)"
_QUALITY_KEY = {"known": SOUND, "a finding concerns it": DOUBTFUL, "idle, left out": IDLE}


def check_report(
    checks: Sequence[LogCheck | Finding],
    told: Sequence[str],
    source: Record,
    together: PooledCheck | None = None,
    commands: Sequence[str] = (),
) -> str:
    """The page.

    Arguments:
        checks: of each log, a finding where it could not be read.
        told: of each log, which mapping it is read through.
        source: what was run on what; shown as it is.
        together: what several logs show together.
        commands: that go on from here.
    """
    read = [one for one in checks if isinstance(one, LogCheck)]
    logs = [_log(one, how) for one, how in zip(checks, told, strict=True)]
    kinds = enumeration(list(dict.fromkeys(one.title for one in read)))
    return render(
        "check.html.j2",
        title=f"Check of {enumeration([log['name'] for log in logs])}",
        subtitle=f"{len(logs)} log{'s' * (len(logs) != 1)}, {kinds}",
        logs=logs,
        together=None if together is None else _together(together),
        commands=commands,
        provenance=provenance(source, [(one.run, "checked") for one in read]),
    )


def _together(pooled: PooledCheck) -> dict[str, Any]:
    """What the template shows of all logs together."""
    names = enumeration(list(pooled.names))
    return {
        "names": names,
        "sentences": headlines(pooled.answers, pooled.commanded, pooled.reversed_turning),
        **_answered(pooled.answers, pooled.scales[0], pooled.cannot_tell, pooled.next),
    }


def _answered(
    answers: Answers,
    scales: Mapping[str, OrderScale],
    cannot_tell: Sequence[OpenQuestion],
    next_records: Sequence[OpenQuestion],
) -> dict[str, Any]:
    """What the template shows of answers, and of what is open."""
    return {
        "lags": _lag_table(answers),
        "answers": _answer_plots(answers),
        "scales": _scale_sentence(scales),
        "questions": _question_table(cannot_tell),
        "next": [capital(question.record or "") + "." for question in next_records],
        "next_length": duration(sum(question.seconds for question in next_records)),
    }


def _log(one: LogCheck | Finding, told: str) -> dict[str, Any]:
    """What the template shows of one log."""
    if isinstance(one, Finding):
        return {
            "name": one.recording,
            "is_read": False,
            "tone": "unexplained",
            "verdict": "not read",
            "lead": f"{one.recording} could not be read.",
            "sentences": (),
            "warnings": [one.message],
        }
    faults = len(one.audit)
    duration = one.run.t[-1] - one.run.t[0]
    used = sum(end - start for start, end in one.used)
    verdict = "sound as far as it shows" if not faults else f"{faults} finding{'s' * (faults > 1)}"
    return {
        "name": one.name,
        "is_read": True,
        "tone": "ambiguous" if faults or one.missing or one.guesses else "consistent",
        "verdict": verdict,
        "lead": f"{capital(one.craft)}. {duration:.0f} s recorded, {used:.0f} s of it used.",
        "sentences": headlines(one.answers, bool(one.run.commanded), one.reversed_turning),
        "warnings": [*map(guess_sentence, one.guesses), *one.missing, *one.notes],
        "quality": quality_plot(one),
        "quality_key": _QUALITY_KEY,
        "faults": _fault_table(one.audit),
        "idle": _idle_table(one),
        "channels": _channel_table(one),
        "mapping": told,
        "plots": _run_plots(one),
        "trials": _trial_table(one),
        **_answered(one.answers, one.scales, one.cannot_tell, one.next),
    }


def guess_sentence(guess: str) -> str:
    """That a channel's column is guessed, and what to do before anything rests on it."""
    return f"guessed, look at it first: {guess}"


def headlines(answers: Answers, commanded: bool, reversed_turning: bool = False) -> list[str]:
    """What logs show, in sentences.

    Arguments:
        commanded: whether orders were recorded.
        reversed_turning: whether the audit says that orders turn it the other way. A controller
            that holds a course turns against the motion, too: the answer alone does not tell.
    """
    told = []
    fastest = max(answers.speed, key=lambda point: point.order, default=None)
    if fastest is not None and fastest.order > LEAST_AHEAD:
        speed = round_to_error(fastest.answer.value, 0.005, "m/s")
        told.append(f"At {100 * fastest.order:.0f} % of full order ahead it makes {speed}.")
    if answers.lag_of_turning is not None:
        delay = answers.lag_of_turning.delay
        span = f"{significant(delay.low, 2)} to {significant(delay.high, 2)} s"
        after = "the order" if commanded else "what was executed"
        if delay.low > 0:
            begins = f"It begins to turn {significant(delay.value, 2)} s after {after} ({span})."
            told.append(begins)
        if answers.lag_of_turning.opposite and reversed_turning:
            told.append("A positive order turns it to port: the sign, or the sides, are exchanged.")
    if answers.asymmetry is not None:
        told += _asymmetry_sentences(answers.asymmetry, answers.paired)
    return told


def _asymmetry_sentences(asymmetry: IntervalEstimate, paired: bool) -> list[str]:
    """Which side is stronger, or that none is by much; nothing where that cannot be told.

    `paired` thrusters differ; of a rudder what it does to starboard and to port. A stronger side is
    named where chance makes one so unlike once in a hundred logs: of ten, one would be at `LEVEL`.
    """
    errors = NormalDist().inv_cdf
    rarely = errors(0.995) / errors(0.5 + 0.5 * LEVEL)
    sure = lambda end: asymmetry.value + rarely * (end - asymmetry.value)
    largest = max(abs(asymmetry.low), abs(asymmetry.high))
    less = lambda ratio: 100 * 2 * abs(ratio) / (1 + abs(ratio))  # per cent of the stronger side
    if sure(asymmetry.low) <= 0 <= sure(asymmetry.high) or abs(asymmetry.value) < LEAST_RATIO:
        if less(largest) > MOST_ALIKE:
            return []
        what = "Port and starboard" if paired else "Turns to port and to starboard"
        return [f"{what} differ by less than {math.ceil(less(largest))} %."]
    share = f"{less(asymmetry.value):.0f} % less"
    # More than zero: the second does more, starboard of a pair, the turn to port of a rudder's two.
    one, other = ("starboard", "port") if asymmetry.value > 0 else ("port", "starboard")
    if paired:
        return [f"{capital(other)} does {share} than {one} for the same order."]
    return [f"It turns {share} to {one} than to {other} for the same order."]


def quality_plot(one: LogCheck) -> Plot | None:
    """A row for each channel, drawn where it is known, and idle stretches across all.

    What concerns a channel at certain times is drawn there; a gap shows by itself.
    """
    if not one.channels:
        return None
    always = [finding for finding in one.audit if not finding.spans and finding.kind != "gap"]
    doubtful = {name for finding in always for name in finding.channels}
    names = list(one.channels)[::-1]
    traces = []
    for row, name in enumerate(names):
        x: list[float | None] = []
        for start, end in one.channels[name].spans:
            x += [round(start, 2), round(end, 2), None]
        colour = DOUBTFUL if name in doubtful else SOUND
        line = go.Scatter(x=x, y=[row] * len(x), mode="lines", showlegend=False)
        line.update(line={"width": 10, "color": colour})
        line.update(hovertemplate=f"{in_words([name])[0]}: %{{x:.1f}} s<extra></extra>")
        traces.append(line)
        last = max((end for _, end in one.channels[name].spans), default=0.0)
        concerning = [
            finding for finding in one.audit if finding.spans and name in finding.channels
        ]
        traces += [_fault_marks(finding, name, row, last) for finding in concerning]
    axis = {
        "tickvals": list(range(len(names))),
        "ticktext": [in_words([name])[0] for name in names],
        "range": [-0.6, len(names) - 0.4],
    }
    drawn = figure(*traces, xaxis={"title": {"text": "time (s)"}}, yaxis=axis)
    drawn.update_layout(hovermode="closest", margin={"t": 10})
    for stretch in one.idle:
        _shade(drawn, (stretch.start, stretch.end), IDLE)
    gaps = sum(len(channel.spans) - 1 for channel in one.channels.values())
    caption = f"{gaps} gap{'s' * (gaps != 1)} in {len(names)} channels" if gaps else "No gaps"
    height = 70 + ROW_HEIGHT * len(names)
    return Plot(drawn, "Where each channel is known, over time", height, caption + ".")


def _fault_marks(finding: Finding, name: str, row: int, last: float) -> go.Scatter:
    """A channel's row where a finding says that it has a fault; marked where that is an instant."""
    x: list[float | None] = []
    for start, end in finding.spans:
        x += [round(start, 2), round(min(end, last), 2), None]
    drawn = go.Scatter(x=x, y=[row] * len(x), mode="lines+markers", showlegend=False)
    drawn.update(line={"width": 10, "color": DOUBTFUL})
    drawn.update(marker={"symbol": "line-ns", "size": 12, "line": {"width": 2, "color": DOUBTFUL}})
    told = f"{in_words([name])[0]}: {finding.kind}, %{{x:.1f}} s<extra></extra>"
    return drawn.update(hovertemplate=told)


def _shade(drawn: go.Figure, span: tuple[float, float], fill: str, opacity: float = 1.0) -> None:
    """Colours a span of time (s) through all panels."""
    place = {"x0": span[0], "x1": span[1], "xref": "x", "y0": 0, "y1": 1, "yref": "paper"}
    look = {"fillcolor": fill, "opacity": opacity, "line": {"width": 0}, "layer": "below"}
    drawn.add_shape(type="rect", **place, **look)


def _fault_table(audit: Sequence[Finding]) -> Table:
    rows = []
    for finding in heaviest_first(audit):
        size = round_to_error(finding.value, finding.std, finding.unit)
        what = [finding.kind, ", ".join(in_words(finding.channels))]
        size = size if math.isfinite(finding.value) else ""
        rows.append([what, size, cost_words(finding.cost), finding.message])
    head = ["finding", "size", "cost in a minute", "what it is"]
    return Table(head, rows, f"Faults that the log shows by itself. {WEIGHED}")


def _idle_table(one: LogCheck) -> Table:
    rows = [[f"{s.start:.0f} s", f"{s.end:.0f} s", s.why] for s in one.idle]
    return Table(["from", "to", "left out because"], rows, "Idle stretches")


def _channel_table(one: LogCheck) -> Table:
    rows = []
    for name, channel in one.channels.items():
        rate = "" if math.isnan(channel.rate) else significant(channel.rate, 3)
        rows.append([Verbatim(name), Verbatim(channel.source), channel.unit, rate])
    return Table(["channel", "column", "unit", "samples per second"], rows, numeric=(3,))


def _run_plots(one: LogCheck) -> list[Plot]:
    """The track with its trials, and speed, yaw rate, rudder angles and orders over time."""
    run, group = one.run, f"run-{one.name}"
    rows = evenly(run.t.size, DRAWN_ROWS)
    plots = []
    if run.has("x") and run.has("y"):
        known = np.isfinite(run.x) & np.isfinite(run.y)
        used = np.any([(run.t >= a) & (run.t <= b) for a, b in one.used], axis=0)
        chosen = np.flatnonzero(known & used)[evenly(int(np.sum(known & used)), DRAWN_ROWS)]
        if chosen.size:
            plots.append(_track_plot(one, chosen, group))
    t, traces = numbers(run.t[rows], 6), []
    speed = np.hypot(run.u, np.where(np.isfinite(run.v), run.v, 0.0))
    series = [("speed", speed, 1, MEASURED), ("yaw rate", np.degrees(run.r), 2, MEASURED)]
    orders = {n: np.asarray(s, float) for n, s in (run.commanded or run.executed).items()}
    angles = {name: np.degrees(values) for name, values in orders.items() if steers(name)}
    shares = {name: 100 * scale.share(orders[name]) for name, scale in one.scales.items()}
    groups = [group for group in (("angles", "deg", angles), ("orders", "%", shares)) if group[2]]
    panels = [("speed", "m/s"), ("yaw rate", "deg/s"), *(group[:2] for group in groups)]
    colours = itertools.cycle((DIAGNOSED, NOMINAL, "#009e73", "#cc79a7"))
    for panel, (_, _, drawn_together) in enumerate(groups, start=3):
        series += [(name, s, panel, next(colours)) for name, s in drawn_together.items()]
    for name, values, panel, colour in series:
        known = np.isfinite(values)
        if not known.any():
            continue
        line = go.Scatter(x=t, y=numbers(values[rows]), name=name, mode="lines", connectgaps=True)
        line.update(line={"color": colour, "width": 1.4, "shape": "hv" if panel > 2 else "linear"})
        line.update(yaxis="y" if panel == 1 else f"y{panel}", showlegend=panel > 2)
        traces.append(line)
    lowest, height = f"y{len(panels)}", 1 / len(panels)
    layout: dict[str, Any] = {"xaxis": {"title": {"text": "time (s)"}, "anchor": lowest}}
    for k, (name, unit) in enumerate(panels):
        key = "yaxis" if k == 0 else f"yaxis{k + 1}"
        ends = [1 - (k + 0.88) * height, 1 - (k + 0.06) * height]
        layout[key] = {"title": {"text": f"{name} ({unit})"}, "domain": ends}
    drawn = add_time_cursor(figure(*traces, **layout), group)
    drawn.update_layout(hovermode="x", legend={"y": 1.0})
    for trial in one.trials:
        _shade(drawn, (trial.onset, trial.end), COLOURS[trial.kind], 0.14)
    what = ["speed", "yaw rate", *(group[0] for group in groups)]
    plots.append(Plot(drawn, f"{capital(enumeration(what))} over time", 140 * len(panels) + 40))
    return plots


def _track_plot(one: LogCheck, chosen: np.ndarray, group: str) -> Plot:
    """North up, the trials coloured."""
    run = one.run
    x, y, t = numbers(run.y[chosen]), numbers(run.x[chosen]), numbers(run.t[chosen], 6)
    path = go.Scatter(x=x, y=y, customdata=t, mode="lines", line={"color": MEASURED, "width": 1.5})
    path.update(hovertemplate="%{customdata:.1f} s<extra></extra>", name="track")
    traces = [path]
    for kind, colour in COLOURS.items():
        inside = np.zeros(chosen.size, dtype=bool)
        for trial in one.trials:
            if trial.kind == kind:
                inside |= (run.t[chosen] >= trial.onset) & (run.t[chosen] <= trial.end)
        if not inside.any():
            continue
        own = [[v if there else None for v, there in zip(s, inside, strict=True)] for s in (x, y)]
        part = go.Scatter(x=own[0], y=own[1], mode="lines", name=kind, hoverinfo="skip")
        traces.append(part.update(line={"color": colour, "width": 3}))
    drawn = add_track_markers(figure(*traces, **TRACK_LAYOUT), group, [0], [DIAGNOSED])
    drawn.update_layout(showlegend=True)
    return Plot(drawn, "The track, north up, with trials coloured", 460)


def trial_order(order: float, paired: bool) -> str:
    """The steering order (rad) of a trial: an angle, or the difference of a pair of thrusters.

    `metrics.orders` has that as an angle of which hard over is a difference as large as the sum.
    """
    if not math.isfinite(order):
        return ""
    if paired and abs(order) > HARD_OVER:
        return "on the spot"  # one ahead, one astern
    if paired:
        return f"{100 * order / HARD_OVER:.0f} % of the sum"
    return f"{math.degrees(order):.1f} deg"


def _trial_table(one: LogCheck) -> Table:
    rows = []
    for trial in one.trials:
        order = trial_order(trial.order, one.answers.paired)
        turned = f"{math.degrees(trial.heading_change):.0f} deg"
        times = f"{trial.onset:.0f} to {trial.end:.0f} s"
        speed = trial.approach.speed
        pace = f"{significant(speed, 3)} m/s" if math.isfinite(speed) else ""
        rows.append(
            [trial.kind, times, trial.side or "", order, turned, pace, trial.approach.verdict]
        )
    columns = ["trial", "time", "side", "order", "turned by", "approach", "approach is"]
    of_a_pair = "; the order is the difference of both thrusters, in shares of their sum"
    caption = f"Trials{of_a_pair if one.answers.paired else ''}"
    return Table(columns, rows, caption)


def _lag_table(answers: Answers) -> Table:
    rows = []
    for what, lag in (
        ("order to turn, to yaw rate", answers.lag_of_turning),
        ("order ahead, to speed", answers.lag_of_speed),
    ):
        if lag is not None:
            rows += _lag_rows(what, lag)
    if answers.asymmetry is not None:
        sides = "port : starboard" if answers.paired else "turns to starboard : to port"
        words = f"{sides} = (1 - ratio) : (1 + ratio)"
        rows.append(["ratio of sides", words, *_cells(answers.asymmetry), ""])
    columns = ["number", "of", "value", "90 % interval", "explained"]
    return Table(columns, rows, numeric=(2, 3, 4))


def _lag_rows(what: str, lag: FirstOrderLag) -> list[list[str]]:
    share = f"{100 * lag.explained:.0f} %"
    return [
        ["dead time", what, *_cells(lag.delay), share],
        ["time constant", what, *_cells(lag.time_constant), share],
    ]


def _cells(one: IntervalEstimate) -> tuple[str, str]:
    """A value and its interval, with as many digits as the interval allows."""
    error = max((one.high - one.low) / 3.3, 1e-9)
    unit = "" if one.unit == "1" else f" {one.unit}"
    low, high = (round_to_error(end, 0.3 * error) for end in (one.low, one.high))
    return round_to_error(one.value, error) + unit, f"{low} to {high}"


def _answer_plots(answers: Answers) -> list[Plot]:
    """Speed by the order ahead, and yaw rate by the order to turn."""
    plots = []
    pairs = (
        ("speed", "order ahead (%)", answers.ahead, answers.speeds, answers.speed),
        (
            "yaw rate",
            "order to turn, to starboard (%)",
            answers.turn,
            answers.rates,
            answers.turning,
        ),
    )
    for name, label, order, values, points in pairs:
        known = np.isfinite(order) & np.isfinite(values)
        if not points or not known.any():
            continue
        unit = points[0].answer.unit
        plots.append(_answer_plot(name, label, order[known], values[known], points, unit))
    return plots


def _answer_plot(
    name: str,
    label: str,
    order: np.ndarray,
    values: np.ndarray,
    points: Sequence[SteadyPoint],
    unit: str,
) -> Plot:
    """All samples, and the means where an order stood, with their intervals."""
    shown = lambda value: for_people(value, unit)[0]
    rows = evenly(order.size, DRAWN_SAMPLES)
    cloud = go.Scatter(x=numbers(100 * order[rows], 3), mode="markers", name="all samples")
    cloud.update(y=numbers([shown(v) for v in values[rows]], 3), hoverinfo="skip")
    cloud.update(marker={"color": MEASURED, "size": 3, "opacity": 0.45})
    means = [shown(point.answer.value) for point in points]
    ends = [(shown(point.answer.low), shown(point.answer.high)) for point in points]
    above = [high - mean for mean, (_, high) in zip(means, ends, strict=True)]
    below = [mean - low for mean, (low, _) in zip(means, ends, strict=True)]
    steady = go.Scatter(x=[100 * point.order for point in points], y=means, name="order stood")
    steady.update(mode="lines+markers", line={"color": DIAGNOSED})
    steady.update(error_y={"array": above, "arrayminus": below, "symmetric": False})
    steady.update(hovertemplate="%{x:.0f} %: %{y:.3g}<extra></extra>")
    people = for_people(0.0, unit)[1]
    axes = {"xaxis": {"title": {"text": label}}, "yaxis": {"title": {"text": f"{name} ({people})"}}}
    return Plot(figure(cloud, steady, **axes), f"{capital(name)} by order", 340)


def _scale_sentence(scales: Mapping[str, OrderScale]) -> str:
    told = []
    for name, scale in scales.items():
        unit = "" if scale.unit in ("own", "normalised") else f" {scale.unit}"
        ends = f"{scale.neutral:g} is none and {scale.full_ahead:g}{unit} full ahead"
        told.append(f"{name}: {ends} ({scale.why})")
    return f"Orders are shares of full order. {'; '.join(told)}." if told else ""


def _question_table(cannot_tell: Sequence[OpenQuestion]) -> Table:
    rows = [[q.what, q.why, q.record or ""] for q in cannot_tell]
    return Table(["cannot be told", "because", "what would tell"], rows)
