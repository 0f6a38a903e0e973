"""Plots of *what*: the odds of every candidate, and what each manoeuvre would tell."""

import textwrap
from collections.abc import Mapping, Sequence

import numpy as np
import plotly.graph_objects as go

from diffsea.report.interactive import CURSOR, DIAGNOSED, MEASURED, NOMINAL, figure
from diffsea.report.quantities import odds, significant, typeset


STATUS = {  # its colour and hatching
    "accepted": (DIAGNOSED, ""), "rival": (NOMINAL, "/"), "rejected": (MEASURED, ""),
    "screened out": ("#ffffff", ""),
}  # fmt: skip
_TICKS = (-100, -10, -3, 0, 3, 10, 30, 100, 300, 1000)  # decimal logarithms of odds
_ROOM = 1.05  # beyond the longest bar
_LINE = 18  # characters
_APART = 0.2  # of the axis, from tick to tick


def odds_plot(candidates: Sequence[tuple[str, str, float]]) -> go.Figure:
    """Candidates (name, status, decimal logarithm of the odds) as bars, in the order given.

    Bars are as long as the logarithm of the logarithm beyond odds of about ten, so that an
    effect beyond doubt leaves room for those in doubt.
    """
    drawn = figure(
        bargap=0.35, barmode="overlay", showlegend=False,
        margin={"t": 8, "l": 8, "r": 12, "b": 40},
    )  # fmt: skip
    for status, (colour, pattern) in STATUS.items():
        own = [one for one in candidates if one[1] == status]
        if own:
            drawn.add_bar(
                orientation="h", name=status, y=[_broken(name) for name, _, _ in own],
                x=[_stretched(size) for _, _, size in own],
                text=[typeset(odds(size)) for _, _, size in own], textposition="none",
                marker={"color": colour, "pattern": {"shape": pattern},
                        "line": {"color": MEASURED, "width": 1}},
                hovertemplate="%{y}: odds %{text}",
            )  # fmt: skip
    sizes = [size for _, _, size in candidates]
    low, high = min([*sizes, 0.0]), max([*sizes, 3.0])
    ticks = _apart([t for t in _TICKS if low <= t <= high], _stretched(high) - _stretched(low))
    drawn.update_xaxes(
        title={"text": "odds in its favour"}, tickvals=[_stretched(t) for t in ticks],
        ticktext=[_short(tick) for tick in ticks], tickangle=0,
        range=[_ROOM * _stretched(low), _ROOM * _stretched(high)],
    )  # fmt: skip
    names = [_broken(name) for name, _, _ in candidates]
    drawn.update_yaxes(categoryorder="array", categoryarray=names[::-1], fixedrange=True)
    return drawn


def _short(tick: float) -> str:
    """Odds without what all have in common: `1000`, `10³⁰`."""
    return typeset(odds(tick).removesuffix(" : 1")).removeprefix("1×")


def _apart(ticks: Sequence[float], reach: float) -> list[float]:
    """Odds of one and those ticks that leave room for their labels."""
    kept = [0.0]
    for tick in sorted(ticks, key=abs):
        if all(abs(_stretched(tick) - _stretched(k)) > _APART * reach for k in kept):
            kept.append(tick)
    return sorted(kept)


def _broken(name: str) -> str:
    """A name on lines short enough for a phone."""
    return "<br>".join(textwrap.wrap(name, _LINE))


def _stretched(size: float) -> float:
    return float(np.sign(size) * np.log10(1 + abs(size)))


def manoeuvre_plot(evidence: Mapping[str, float], decisive: float) -> go.Figure:
    """Expected evidence (twice the log of odds) of each manoeuvre, the best on top."""
    ranked = sorted(evidence, key=lambda name: evidence[name])
    values = [evidence[name] for name in ranked]
    drawn = figure(
        go.Bar(
            orientation="h", y=[name.replace("-", " ") for name in ranked], x=values,
            text=[typeset(significant(value, 2)) for value in values], textposition="auto",
            marker={"color": [*[MEASURED] * (len(ranked) - 1), DIAGNOSED]},
            hovertemplate="%{y}: %{text}<extra></extra>",
        ),
        margin={"t": 28, "l": 8, "r": 12, "b": 40}, bargap=0.3,
        xaxis={"title": {"text": "expected 2 ln(odds)"}},
    )  # fmt: skip
    drawn.add_vline(
        x=decisive, line={"color": CURSOR, "width": 1.5, "dash": "dot"},
        annotation={"text": "odds 1000 : 1", "yanchor": "bottom", "y": 1.0},
    )  # fmt: skip
    return drawn.update_yaxes(fixedrange=True)
