"""Online estimates as one page for people: trust over time, each estimate, why the gate closed."""

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go

from diffsea.identification.online.closed_spans import ClosedSpan
from diffsea.identification.online.guarded import OnlineRun
from diffsea.identification.online.trust import ALARM_TRUST
from diffsea.parameters import named, parameter_unit
from diffsea.report import plots
from diffsea.report.page import Plot, Table, Verbatim, provenance, render
from diffsea.report.quantities import round_to_error, with_error
from diffsea.report.wording import words
from diffsea.report.wording.words import Record
from diffsea.trajectory import Trajectory
from diffsea.vessel.base import Vessel


DRAWN_ROWS = 1200  # of a run: more cannot be told apart
PANEL_HEIGHT, PANEL_GAP = 150, 0.07  # pixels of a panel; share of one panel's place above it
SHOWN_SPANS = 20  # in which the gate was closed; the longest
CLOSED_FILL = "rgba(213, 94, 0, 0.13)"
BAND_FILL = "rgba(0, 114, 178, 0.18)"
WITHIN = 2.0  # standard errors of the band
REACH = 2.0  # times the range of the later half within which a panel shows the earlier one


def online_report(
    vessel: Vessel,
    recording: Trajectory,
    run: OnlineRun,
    rows: Sequence[Record],
    closed: Sequence[ClosedSpan],
    source: Record,
) -> str:
    """The page.

    Arguments:
        rows: a row for each parameter, as `OnlineResult.rows` has them.
        closed: when the gate was closed, and why.
        source: what was run on what, and the settings; shown as it is.
    """
    seconds, share = run.t[-1] - run.t[0], float(run.open.mean())
    state = "open" if run.open[-1] else "closed"
    passed = any(np.any(run.handed[name] != run.handed[name][0]) for name in run.handed)
    longest = sorted(closed, key=lambda span: span.start - span.end)[:SHOWN_SPANS]
    shown = sorted(longest, key=lambda span: span.start)
    kept = plots.evenly(len(run.t), DRAWN_ROWS)
    return render(
        "online.html.j2",
        title=f"Online estimates of {vessel.name}",
        subtitle=f"along {recording.name}, {seconds:.0f} s",
        lead=f"The gate was open for {100 * share:.0f} % of the time and is {state} at the end.",
        passed="" if passed else "Nothing passed it: a controller would have kept the vessel file.",
        trust_at_end=f"{run.trust[-1]:.2f}",
        alarm=f"{ALARM_TRUST:g}",
        window=f"{float(run.guard.limits.window):g}",
        parameters=parameter_table(rows),
        trust=Plot(trust_plot(run, closed, kept), "Trust over time", 230),
        estimates=[
            Plot(estimate_plot(name, vessel, run, closed, kept), f"{name} over time", PANEL_HEIGHT)
            for name in run.estimate
        ],
        closed=span_table(shown),
        more_spans=len(closed) - len(shown),
        provenance=provenance(source, [(recording, "estimated along")]),
    )


def parameter_table(rows: Sequence[Record]) -> Table:
    """Each parameter: in the vessel file, the last estimate, what a controller had at the end."""

    def unmoved(row: Record) -> bool:
        return row["passed by the gate"] == row["vessel file"]

    cells = [
        [
            Verbatim(row["symbol"]),
            row["name"],
            round_to_error(row["vessel file"]),
            with_error(row["last estimate"], row["+-"]),
            # The file's own number where nothing passed: the same digits, then.
            round_to_error(row["passed by the gate"], None if unmoved(row) else row["+-"]),
            row["unit"],
        ]
        for row in rows
    ]
    columns = ["symbol", "name", "vessel file", "last estimate", "passed by the gate", "unit"]
    return Table(columns, cells, "+- is one standard error", numeric=(2, 3, 4))


def span_table(closed: Sequence[ClosedSpan]) -> Table:
    """When the gate was closed, and why."""
    rows = [
        [f"{span.start:.1f}", f"{span.end:.1f}", list(span.reasons) or "no alarm: it waited"]
        for span in closed
    ]
    return Table(["from (s)", "to (s)", "why"], rows, numeric=(0, 1))


def trust_plot(run: OnlineRun, closed: Sequence[ClosedSpan], kept: slice) -> go.Figure:
    """Trust over time with the alarm level, shaded where the gate was closed."""
    drawn = plots.figure(hovermode="x", showlegend=False, margin={"t": 8})
    line = {"color": plots.DIAGNOSED, "width": 1.5}
    drawn.add_scatter(**_curve(run.t[kept], run.trust[kept]), name="trust", line=line)
    drawn.update_yaxes(range=[0, 1.02], title={"text": "trust"})
    drawn.update_xaxes(title={"text": "time (s)"})
    drawn = plots.add_time_cursor(drawn, "online")
    drawn.add_hline(ALARM_TRUST, line={"color": plots.MEASURED, "width": 1, "dash": "dot"})
    return _shade(drawn, closed)


def estimate_plot(
    name: str, vessel: Vessel, run: OnlineRun, closed: Sequence[ClosedSpan], kept: slice
) -> go.Figure:
    """One estimate with its band, what the gate passed, and the vessel file's number."""
    t, value, std = run.t[kept], run.estimate[name][kept], run.std[name][kept]
    passed = run.handed[name][kept]
    unit = f" ({parameter_unit(name)})" if parameter_unit(name) else ""
    drawn = plots.figure(hovermode="x", showlegend=False, margin={"t": 26, "b": 26})
    nothing = {"line": {"width": 0}, "hoverinfo": "skip"}
    drawn.add_scatter(**_curve(t, value - WITHIN * std), **nothing)
    drawn.add_scatter(
        **_curve(t, value + WITHIN * std), **nothing, fill="tonexty", fillcolor=BAND_FILL
    )
    line = {"color": plots.DIAGNOSED, "width": 1.5}
    drawn.add_scatter(**_curve(t, value), name="estimate", line=line)
    line = {"color": plots.NOMINAL, "width": 2, "shape": "hv"}
    drawn.add_scatter(**_curve(t, passed), name="passed", line=line)
    nominal = float(named(vessel)[name])
    drawn.update_yaxes(range=_range(value, std, passed, nominal), nticks=5)
    drawn.add_annotation(plots.heading(words.capital(f"{name}{unit}"), 1.0))
    drawn = plots.add_time_cursor(drawn, "online")
    drawn.add_hline(nominal, line={"color": plots.MEASURED, "width": 1, "dash": "dot"})
    return _shade(drawn, closed)


def _curve(t: np.ndarray, values: np.ndarray) -> dict[str, object]:
    """A line of a plot."""
    x = plots.numbers(t, plots.TIME_DIGITS)
    return {"x": x, "y": plots.numbers(values), "mode": "lines"}


def _range(value: np.ndarray, std: np.ndarray, passed: np.ndarray, nominal: float) -> list[float]:
    """The later half with its band and what passed; of the first rows only what is near."""
    half = len(value) // 2
    ends = np.concatenate([value[half:] - WITHIN * std[half:], value[half:] + WITHIN * std[half:]])
    near = np.concatenate([ends[np.isfinite(ends)], passed[np.isfinite(passed)], [nominal]])
    low, high = float(near.min()), float(near.max())
    room = REACH * max(high - low, 1e-9 * max(abs(high), 1.0))
    early = value[np.isfinite(value)]
    if early.size:
        low = min(low, max(float(early.min()), low - room))
        high = max(high, min(float(early.max()), high + room))
    margin = 0.06 * max(high - low, 1e-9 * max(abs(high), 1.0))
    return [low - margin, high + margin]


def _shade(drawn: go.Figure, closed: Sequence[ClosedSpan]) -> go.Figure:
    """Shade the times in which the gate was closed; after the cursor, which is the first shape."""
    style = {"fillcolor": CLOSED_FILL, "line": {"width": 0}, "layer": "below"}
    for span in closed:
        drawn.add_vrect(x0=span.start, x1=span.end, **style)
    return drawn
