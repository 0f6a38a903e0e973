"""results.json and the README's tables."""

import math

from experiments.harness.reporting import compared, comparison, table
from experiments.virtual_sea_trials import (
    marus_asymmetry,
    marus_fit,
    marus_support,
    marus_trials,
    marus_vessel,
)
from experiments.virtual_sea_trials import marus_published as published


def assembled(
    found, uneven, supported: dict, runs, turning: dict, beyond: dict
) -> tuple[dict, dict[str, str]]:
    """The record of results.json and the tables by key."""
    figures = _figures(found, uneven, runs)
    rows = [*_begun(runs, found.hull), *_approach(runs), *figures, *_traced(runs)]
    results = {
        "comparison": rows,
        "campaign": _campaign(runs),
        "repeated": runs.repeated,
        "diameters": turning,
        "beyond": beyond,
    }
    tables = {
        "comparison": comparison(rows),
        "trace": _trace_table(runs),
        "driven": _driven_table(runs),
    }
    if found.objective is not None:
        results |= _fitted(found, uneven) | {"support": supported}
        tables |= {
            "misfit": marus_support.misfit_table(supported["misfit"]),
            "foretold": marus_support.foretold_table(supported["foretold"]),
            "inertia": marus_support.inertia_table(supported["inertia"]),
            "derivatives": _derivatives(results["derivatives"]),
            "directions": _directions(results["directions"]),
            "asymmetry": _asymmetry(results["asymmetry"]),
            "diameters": _diameters(turning),
            "zigzags": _zigzags(turning),
            "beyond": _beyond(beyond),
            "effects": _effects(beyond),
        }
    return results, tables


def _begun(runs, hull: dict[str, float]) -> list[dict]:
    """When the trials start and at which speed, with what was set or assumed for it."""
    drag = marus_vessel.drag_at(hull, published.SPEED_85)
    share = published.TARGET_SPEED / published.SPEED_85
    starts = [marus_trials.onset(one.log) for one in runs.at_once]
    return [
        compared("start of the trials", "s", published.STARTS, max(starts),
                 f"set: {marus_trials.SETTLING:g} ship lengths of running before the order"),
        compared("target speed over that at 85 % of the rating", "1", published.TARGET_SHARE,
                 share, "of the printed speeds"),
        compared("largest continuous thrust, both thrusters", "N", None,
                 drag / published.RATING_SHARE,
                 "assumed: the rating is of thrust, so that 85 % of it is the drag at "
                 f"{published.SPEED_85:g} m/s, {drag:.4g} N by the fit with both sides alike"),
    ]  # fmt: skip


def _approach(runs) -> list[dict]:
    """Table 2: as published, and as logged here from a speed held without disturbance."""
    rows = []
    for one in runs.at_once:
        window = marus_trials.approach_window(one.log, one.segment.onset)
        title = f"approach, {one.run.title}"
        rows += [
            compared(f"{title}: mean speed", "m/s", one.run.speed, window["speed"]),
            compared(f"{title}: its deviation", "m/s", one.run.speed_std, window["speed_std"]),
            compared(f"{title}: largest yaw rate", "deg/s", one.run.yaw_rate, window["yaw_rate"]),
            compared(f"{title}: verdict", "", "pass", window["verdict"]),
        ]
    return rows


def _figures(found, uneven, runs) -> list[dict]:
    """Tables 3 and 4, all their cells, with the verdicts on them."""
    even: dict[tuple, float] = {}
    if found.objective is not None:
        best = uneven.candidates[0]
        chosen = marus_fit.figures(found.objective, best.estimate.coordinates)
        plain = marus_fit.figures(found.objective, found.even.coordinates)
        even = {(row["run"], row["number"]): row["obtained"] for row in plain}
        got = {(row["run"], row["number"]): row["obtained"] for row in chosen}
    else:
        got = {
            (one.run.name, name): one.metrics[name] / published.in_si(name)
            for one in runs.at_once
            for name in one.run.numbers
            if name in one.metrics
        }
    rows = []
    for one in runs.at_once:
        for name, value in one.run.numbers.items():
            key = (one.run.name, name)
            note = f"port and starboard alike: {even[key]:.3f}" if key in even else ""
            title = f"{one.run.title}: {name.replace('_', ' ')}"
            rows.append(compared(title, published.unit(name), value, got.get(key), note))
            if name.startswith("overshoot"):
                peak = one.run.heading + value
                told = None if got.get(key) is None else one.run.heading + got[key]
                ordinal = "first" if name.endswith("1") else "second"
                rows.append(compared(f"{one.run.title}: {ordinal} heading peak", "deg", peak, told))
        verdicts = {entry["verdict"] for entry in one.metrics["imo"].values()}
        told = "pass" if verdicts == {"pass"} else ", ".join(sorted(verdicts)) or None
        rows.append(compared(f"{one.run.title}: IMO MSC.137(76)", "", "pass", told))
    return rows


def _traced(runs) -> list[dict]:
    circle = next(one for one in runs.at_once if one.run.name == "circle-port")
    found = marus_trials.yaw_consistency(circle.log)
    note = "set by the noise of the logs, which is not published"
    return [
        compared("logged against reconstructed yaw rate: correlation", "",
                 published.YAW_CORRELATION, found["correlation"], note),
        compared("logged against reconstructed yaw rate: rms difference", "deg/s",
                 published.YAW_RMS, found["rms"], note),
    ]  # fmt: skip


def _campaign(runs) -> dict:
    """Both sets of logs: onset, realisation of the orders, checks, numbers."""
    out = {}
    for title, logged in (("at once", runs.at_once), ("real", runs.real)):
        out[title] = {
            one.run.name: {
                "onset": marus_trials.onset(one.log),
                "segment_onset": one.segment.onset,
                "ordered": one.segment.ordered,
                "approach": one.segment.approach.verdict,
                "realisation": marus_trials.realisation(one.log, one.segment.onset),
                "reversals": marus_trials.reversals(one.log, one.segment.onset),
                "checks": {c.name: {"verdict": c.verdict, "why": c.why} for c in one.checks},
                "yaw": marus_trials.yaw_consistency(one.log),
                "numbers": {
                    name: one.metrics[name] / published.in_si(name)
                    for name in one.run.numbers
                    if name in one.metrics
                },
            }
            for one in logged
        }
    return out


def _trace_table(runs) -> str:
    rows = []
    for logged, title in ((runs.at_once, "at once"), (runs.real, "lag, dead band, limit")):
        for one in logged:
            ratio = marus_trials.realisation(one.log, one.segment.onset)
            check = next(c for c in one.checks if c.name == "actuation")
            shown = "overshoot_1" if one.run.heading else "tactical_diameter"
            value = one.metrics.get(shown, math.nan) / published.in_si(shown)
            spread = f"{ratio['low']:.2f} to {ratio['high']:.2f}"
            rows.append(
                (one.run.title, title, ratio["median"], spread, check.verdict,
                 f"{value:.3g} {published.unit(shown)}")
            )  # fmt: skip
    head = ("trial", "thrusters", "executed / ordered, median", "2 % to 98 %", "check",
            "first overshoot or tactical diameter")  # fmt: skip
    return table(head, rows)


def _driven_table(runs) -> str:
    """How often each zig-zag was reversed, and how far its repeat is off."""
    counted = [
        (f"reversals after the onset, {one.run.title}",
         marus_trials.reversals(one.log, one.segment.onset))
        for one in runs.at_once
        if one.run.heading
    ]  # fmt: skip
    repeated = ("largest difference of any sample, all trials run once more (SI)", runs.repeated)
    return table(("", ""), [*counted, repeated])


def _fitted(found, uneven) -> dict:
    objective, even = found.objective, found.even
    candidates = list(uneven.candidates)
    shares = marus_asymmetry.shares(candidates)
    best = candidates[0]
    return {
        "derivatives": marus_fit.derivative_rows(objective, even),
        "directions": marus_fit.directions(objective, even),
        "not_determined": marus_fit.in_words(objective, even).sentences,
        "starts": list(found.deviances),
        "misfit": found.misfit,
        "hull": found.hull,
        "asymmetry": [
            {
                "name": one.name, "parameters": one.parameters, "drop": one.drop,
                "log10_odds": one.log10_odds, "share": shares[one.name],
            }
            for one in candidates
        ],
        "even_share": shares["even"],
        "rivals": marus_asymmetry.rivals(candidates),
        "figures": {
            "even": marus_fit.figures(objective, even.coordinates),
            "uneven": marus_fit.figures(objective, best.estimate.coordinates),
        },
    }  # fmt: skip


def _derivatives(rows: list[dict]) -> str:
    head = ("", "unit", "start", "estimate", "90 % interval", "due to the figures")
    cells = [
        (row["name"], row["unit"], row["start"], row["value"],
         f"{row['low']:.3g} to {row['high']:.3g}", f"{100 * row['determined']:.0f} %")
        for row in rows
    ]  # fmt: skip
    return table(head, cells)


def _directions(rows: list[dict]) -> str:
    cells = []
    for row in rows:
        if row["determined"] > 0.5:
            continue
        parts = sorted(row["vector"].items(), key=lambda item: -abs(item[1]))
        told = " ".join(f"{weight:+.2f} {name}" for name, weight in parts if abs(weight) > 0.2)
        cells.append((f"{100 * row['determined']:.1f} %", told))
    return table(("determined", "direction, in prior widths"), cells)


def _asymmetry(rows: list[dict]) -> str:
    cells = []
    for row in rows:
        told = ", ".join(f"{name} {value:.3g}" for name, value in row["parameters"].items())
        cells.append((row["name"], told, row["drop"], f"{row['log10_odds']:.1f}",
                      f"{100 * row['share']:.1f} %"))  # fmt: skip
    head = ("", "estimate (SI)", "fall of the deviance", "log10 odds", "probability among these")
    return table(head, cells)


def _diameters(turning: dict) -> str:
    needed = turning["least_drift"]
    rows = [
        ("vessels drawn that complete the circle", turning["drawn"]),
        ("of these with the steady diameter the larger one, %", 100 * turning["share_above"]),
        ("least tactical over steady diameter among them", turning["least_ratio"]),
        ("of them below cos(steady drift), %", 100 * turning["share_below_cosine"]),
        ("fitted vessel: tactical over steady diameter", turning["fitted"]["ratio"]),
        ("fitted vessel: steady drift, deg", turning["fitted"]["drift"]),
        (
            "drift that the published circle to port needs, deg",
            needed["circle-port"],
        ),
        ("and the one to starboard, deg", needed["circle-starboard"]),
    ]
    return table(("", ""), rows)


def _zigzags(turning: dict) -> str:
    told, turn = turning["zigzags"], turning["turn"]
    rows = [
        ("peak yaw rate goes with the order to the power of", told["exponent"], None),
        ("yaw rate at 35 deg, deg/s", told["rate"], turn["rate"]),
        ("speed in the circle, m/s", told["speed"], turn["speed"]),
        ("speed lost, %", 100 * told["loss"], 100 * turn["loss"]),
    ]
    return table(("", "from the published figures", "fitted vessel"), rows)


def _beyond(beyond: dict) -> str:
    ways = list(beyond["ways"])
    rows = []
    for name, true in beyond["truth"].items():
        cells = [name, true]
        for way in ways:
            one = beyond["ways"][way][name]
            cells.append(f"{one['value']:.4g} ({100 * beyond['errors'][way][name]:+.1f} %)")
        rows.append(cells)
    return table(("", "true", *ways), rows)


def _effects(beyond: dict) -> str:
    true = ", ".join(f"{name} {value:.3g}" for name, value in beyond["actuators"].items())
    rows: list[tuple] = [("hidden", true, "", "")]
    for one in beyond["effects"]:
        told = ", ".join(f"{name} {value:.3g}" for name, value in one["parameters"].items())
        rows.append((one["name"], told, f"{one['log10_odds']:.0f}", ", ".join(one["alternatives"])))
    return table(("named", "estimate (SI)", "log10 odds", "not told from"), rows)
