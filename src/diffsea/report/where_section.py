"""The section of a diagnosis that says *where* model and recordings differ."""

import html
from collections.abc import Mapping, Sequence

from diffsea.report import words as words
from diffsea.report.interactive import GREY, PALE, plot, stepped
from diffsea.report.location_plots import (
    DEGREES,
    REACH,
    Cells,
    Colouring,
    coloured_track,
    latent_colourings,
    regime_map,
    time_map,
    window_colourings,
)
from diffsea.report.page import (
    Content,
    Html,
    element,
    folded,
    grid,
    joined,
    markup,
    paragraph,
    section,
    table,
    verbatim,
)
from diffsea.report.quantities import known, probability, significant
from diffsea.trajectory import Trajectory


_PLACES = 8
_OPEN_RUNS = 6
_NOMINAL, _FINAL = "nominal model", "diagnosed model"


def where_section(result: dict, recordings: Sequence[Trajectory], most: int) -> Html:
    """Maps by time and by regime, tracks coloured by force, and the strongest places.

    Arguments:
        recordings: those that were fitted.
        most: points of a track.
    """
    heading = "Where do model and recordings differ?"
    after = result.get("map_after") if words.accepted(result) else None
    maps = {_NOMINAL: result.get("map"), _FINAL: after}
    given = {title: one for title, one in maps.items() if one}
    if not given:
        text = "The map of where they differ was not computed."
        return section("where", heading, paragraph(text), _strongest(result))
    threshold = _threshold(given)
    text = (
        "An unnamed force is added to the model in one window of time or one regime, and tested. "
        "z is its size in standard errors: positive ahead, to starboard, or turning the bow to "
        "starboard. A number in a cell says that chance alone would hardly give so much anywhere."
    )
    return section(
        "where",
        heading,
        paragraph(text),
        _key(threshold),
        _by_regime(given, threshold),
        _by_time(result, given, threshold, recordings, most),
        _strongest(result),
    )


def _threshold(maps: Mapping[str, dict]) -> float:
    given = [one["threshold"] for one in maps.values() if known(one.get("threshold"))]
    return float(given[0]) if given else 3.0


def _key(threshold: float) -> Html:
    stops = ", ".join(f"{colour} {100 * at:.1f}%" for at, colour in stepped(1 / REACH))
    reach = significant(REACH * threshold, 2)
    return Html(
        f'<div class="key"><span>{markup(f"z: -{reach}")}'
        f'<i style="background:linear-gradient(to right, {stops})"></i>+{reach}</span>'
        f'<span><i class="small" style="background:{PALE[1]}"></i>pale, within '
        f"±{significant(threshold, 2)}: not significant</span>"
        f'<span><i class="small" style="background:{GREY}"></i>the data cannot tell</span></div>'
    )


def _by_regime(maps: Mapping[str, dict], threshold: float) -> Html:
    drawn = []
    for title, one in maps.items():
        cells = one.get("regime", [])
        if cells:
            height = 60 + 24 * len({cell["regime"] for cell in cells})
            text = _told(f"By regime, {title}", cells, threshold)
            drawn.append(plot(regime_map(title, cells, threshold), text, height))
    if not drawn:
        return paragraph("The map by regime was not computed.", "note")
    return joined([element("h3", "By what the vessel was doing"), grid(drawn)])


def _told(title: str, cells: Cells, threshold: float) -> str:
    """What a map shows, in words."""
    counts = []
    for name in DEGREES:
        own = [abs(c.get("z") or 0.0) for c in cells if c["degree_of_freedom"] == name]
        counts.append(f"{name} {sum(z >= threshold for z in own)} of {len(own)}")
    return f"{title}, significant cells: {', '.join(counts)}."


def _by_time(
    result: dict,
    maps: Mapping[str, dict],
    threshold: float,
    recordings: Sequence[Trajectory],
    most: int,
) -> Html:
    times = {title: one.get("time", []) for title, one in maps.items()}
    if not any(times.values()):
        return paragraph("The map by time was not computed.", "note")
    colourings = _colourings(result, times, recordings, most)
    cards = []
    for number, run in enumerate(recordings):
        own = {t: [c for c in cells if c["recording"] == run.name] for t, cells in times.items()}
        own = {title: cells for title, cells in own.items() if cells}
        cards.append((_strength(own), _run(run, own, threshold, colourings, number, most)))
    ranked = sorted(range(len(cards)), key=lambda k: -cards[k][0])[:_OPEN_RUNS]
    rest = [card for k, (_, card) in enumerate(cards) if k not in ranked]
    return joined(
        [
            element("h3", "By time, and along the track"),
            _chooser(colourings),
            *(card for k, (_, card) in enumerate(cards) if k in ranked),
            folded(f"{len(rest)} more runs", joined(rest)) if rest else "",
        ]
    )


def _strength(own: Mapping[str, Cells]) -> float:
    return max((abs(c.get("z") or 0.0) for cells in own.values() for c in cells), default=0.0)


def _colourings(
    result: dict, times: Mapping[str, Cells], recordings: Sequence[Trajectory], most: int
) -> list[Colouring]:
    """What tracks may be coloured by, that with the largest z-score first."""
    located = [run for run in recordings if run.has("x") and run.has("y")]
    latent = result.get("residual_force") or {}
    out = []
    for title, cells in times.items():
        if title == _FINAL and latent:
            continue  # what remains at every instant says more than windows do
        own = window_colourings(title, cells, located, most)
        if not out:
            best = max(cells, key=lambda c: abs(c.get("z") or 0.0), default=None)
            own.sort(key=lambda one: best is None or best["degree_of_freedom"] not in one.label)
        out += own
    return out + latent_colourings("what remains", latent, located, most)


def _chooser(colourings: Sequence[Colouring]) -> Html:
    if not colourings:
        return Html("")
    options = "".join(
        f'<option value="{html.escape(one.label, quote=True)}">{markup(one.label)}</option>'
        for one in colourings
    )
    text = (
        "The colour of a track is the force that would bring the model to the recording; where "
        "z is not significant it may be chance."
    )
    return Html(
        f'<p><label>Colour the tracks by the force <select class="colouring">'
        f"{options}</select></label></p>{paragraph(text, 'note')}"
    )


def _run(
    run: Trajectory,
    maps: Mapping[str, Cells],
    threshold: float,
    colourings: Sequence[Colouring],
    number: int,
    most: int,
) -> Html:
    group = f"recording-{number}"
    drawn = []
    if maps:
        text = " ".join(_told(f"{run.name}, {t}", cells, threshold) for t, cells in maps.items())
        height = 70 + 115 * len(maps)
        drawn.append(plot(time_map(maps, threshold, group), text, height))
    if run.has("x") and run.has("y"):
        text = f"Track of {run.name}, coloured by the force that the model lacks."
        figure = coloured_track(run, colourings, group, most)
        drawn.append(plot(figure, text, 420, classes="coloured"))
    return joined(
        [element("h3", verbatim(run.name)), Html(f'<div class="run">{joined(drawn)}</div>')]
    )


def _strongest(result: dict) -> Content:
    cells = result.get("where", [])
    if not cells:
        return paragraph("No window of time and no regime of the nominal model stands out.")
    rows = [
        [
            cell["degree_of_freedom"],
            verbatim("all runs" if cell["recording"] == "all" else cell["recording"]),
            "whole run" if cell["recording"] == "all"
            else f"{cell['start']:.0f} to {cell['end']:.0f} s",
            cell["regime"],
            f"{significant(cell['force_rms'], 2)} {cell['unit']}",
            probability(cell["p_value"]),
        ]
        for cell in cells[:_PLACES]
    ]  # fmt: skip
    columns = ["degree of freedom", "recording", "when", "regime", "force missing", "p"]
    title = "Strongest places in the nominal model (p of each by itself)"
    return table(columns, rows, title, numeric=(4, 5))
