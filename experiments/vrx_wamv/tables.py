# pyright: reportArgumentType=false
"""Rows of the comparison with the paper, and the README's tables."""

from experiments.harness.reporting import compared, table
from experiments.vrx_wamv.closed import SECONDS
from experiments.vrx_wamv.models import HULL, truth
from experiments.vrx_wamv.plant import NEW
from experiments.vrx_wamv.procedure import PUBLISHED, PUBLISHED_FIRST, masses, readings_of_masses
from experiments.vrx_wamv.stages import Followed, Identified
from experiments.vrx_wamv.tuning import BOUNDS, NAMES, Tuned

import numpy as np


SPEEDS, THRUST = "speeds alone", "thrust as ordered"
DRAG = {"X_u": "surge drag X_u", "Y_v": "sway drag Y_v", "N_r": "yaw drag N_r"}
DRAG_UNITS = {"X_u": "N s/m", "Y_v": "N s/m", "N_r": "N m s/rad"}


def plant_rows(checks: dict) -> list[dict]:
    """The reference plant beside the closed form and the paper's remarks on the simulator."""
    rows = []
    for thrust in (100, 500, 2000):
        found = checks[f"new {thrust} N"]
        note = f"not printed; closed form of the plant's equations: {found['closed form']:.4g}"
        name = f"steady speed at {thrust} N"
        rows.append(compared(name, "m/s", None, found["integrated"], note))
    fastest = checks["new 500 N"]["integrated"]
    rows.append(compared("largest speed, at 250 N an engine", "m/s", 1.5, fastest))
    published = float(PUBLISHED.thrust(np.array(30.0), np.array(1.5)))
    note = "published: eq. 10 at 30 rev/s and 1.5 m/s; obtained: the plant's mapping"
    rows.append(compared("thrust at 30 rev/s", "N", published, NEW.thrust(30.0), note))
    return rows


def procedure_rows(found: Identified, arithmetic: dict) -> list[dict]:
    """Every coefficient of the paper, with eq. 9 read both ways."""
    rows = []
    for reading in (SPEEDS, THRUST):
        first, model = found.procedures[reading].first, found.procedures[reading].corrected
        label = f"eq. 9 from {reading}" if reading == SPEEDS else f"eq. 9, {reading}"
        for name, published, unit in (("c", -0.397956, "N s^2/m"), ("d", 0.299914, "N s^2")):
            rows.append(compared(f"{name}, {label}", unit, published, getattr(first, name)))
        for name, words in DRAG.items():
            published = 145.75 if name == "X_u" else getattr(PUBLISHED_FIRST, name)
            unit = DRAG_UNITS[name]
            value = getattr(first, name)
            rows.append(compared(f"{words}, {label}", unit, published, value))
        for name in ("X_u", "N_r"):
            value, unit = getattr(model, name), DRAG_UNITS[name]
            words = f"{DRAG[name]} corrected, {label}"
            rows.append(compared(words, unit, getattr(PUBLISHED, name), value))
    speed = arithmetic["speed_by_first_fit"]
    note = "obtained: what the paper's own c, d and X_u = 145 give in its eq. 9"
    rows.append(compared("steady speed at 29.9 rev/s", "m/s", 1.5, speed, note))
    speed = arithmetic["speed_after_correction"]
    rows.append(compared("likewise with the corrected X_u = 340", "m/s", 1.5, speed))
    return rows


def mass_rows() -> list[dict]:
    """Eqs. 13 to 15 from Table 1, and the reading that comes nearest."""
    names = (("m11, eq. 13", "kg", 189.0), ("m22, eq. 14", "kg", 229.0),
             ("m33, eq. 15", "kg m^2", 333.0))  # fmt: skip
    plain = masses()
    nearest = min(readings_of_masses(), key=lambda one: abs(one[1][2] - 333.5))
    note = f"{nearest[1][1]:.1f} and {nearest[1][2]:.1f} with {nearest[0]}"
    return [
        compared(name, unit, published, value, note if name.startswith("m33") else "")
        for (name, unit, published), value in zip(names, plain, strict=True)
    ]


def path_rows(followed: Followed) -> list[dict]:
    """Differences of model and plant on the paper's paths, beside its figures."""
    rows = []
    for model, paths in followed.table.items():
        for path, one in paths.items():
            published = 2.0 if path.endswith("circle") else 0.0
            words, time, distance, note = f"{path}, {model}", *_errors(one), ""
            if not one["finished"]:
                note = f"the model is not at the end after {SECONDS:g} s"
            rows.append(compared(f"time error, {words}", "%", published, time, note))
            rows.append(compared(f"distance error, {words}", "%", 0.37, distance, note))
    return rows


def _errors(one: dict) -> tuple[float | None, float | None]:
    """Errors of time and distance in per cent; none of a run that was cut off."""
    if not one["finished"]:
        return None, None
    return 100 * one["time"], 100 * one["distance"]


def parameters(found: Identified) -> str:
    """The parameters of every model."""
    models = [n for n in found.values if n != "published, uncorrected"]
    true = truth(NEW)
    stds = found.joint["joint"].stds
    rows = []
    for key in (*HULL, "c", "d"):
        cells = [found.values[m].get(key, 0.0 if key in HULL else None) for m in models]
        cells = [_held(m, key, cell) for m, cell in zip(models, cells, strict=True)]
        std = f"{stds[key]:.2g}" if key in stds else "-"
        rows.append((key, true.get(key, 0.0), *cells, std))
    return table(("", "plant", *models, "its standard error"), rows)


def _held(model: str, key: str, value: float | None) -> float | str | None:
    if model.startswith("joint") and key == "d":
        return "held"
    if model == "joint, linear" and key == "c":
        return "held"
    return value


def quality(found: Identified, errors: dict) -> str:
    """How well every model predicts runs kept back, and what it took to find."""
    rows = [
        (name, *(errors[name][key] for key in ("position", "u", "v", "r")),
         found.seconds.get(name))
        for name in found.values
    ]  # fmt: skip
    head = (
        "model",
        "position, m",
        "surge, m/s",
        "sway, m/s",
        "yaw rate, rad/s",
        "processor time, s",
    )
    return table(head, rows)


def gauge(rows: list[dict]) -> str:
    """Eq. 9 from several starts."""
    names = ("c", "d", "X_u", "c/d", "X_u/d")
    cells = [(", ".join(f"{x:g}" for x in row["start"]), *(row[n] for n in names)) for row in rows]
    return table(("start (c, d, X_u)", *names), cells)


def paths(followed: Followed) -> str:
    """Every model on the paper's paths."""
    rows = [
        (name, path, one["finished"], *_errors(one), one["position"],
         100 * one["position_share"], one["open_loop_position"])
        for name, by_path in followed.table.items() for path, one in by_path.items()
    ]  # fmt: skip
    head = (
        "model", "path", "finished", "time error, %", "distance error, %",
        "apart at equal times, m", "of the length, %", "apart without a controller, m",
    )  # fmt: skip
    return table(head, rows)


def verified(quiet: dict, noisy: dict) -> str:
    """Sets of gains on the plant."""
    rows = []
    for name in quiet:
        for path, one in quiet[name].items():
            noise = noisy[name][path] if noisy else {"rms": None}
            rows.append((path, name, one["rms"], one["largest"], one["seconds"], noise["rms"]))
    rows.sort(key=lambda row: row[0])
    head = ("path", "gains", "off the path, rms m", "largest, m", "time, s", "rms with noise, m")
    return table(head, rows)


def laws(found: dict[str, dict]) -> str:
    """Fixed gains and those that follow distance and heading error, on the plant."""
    rows = [
        (path, name, one["rms"], one["largest"], one["seconds"], one["finished"])
        for name, ways in found.items()
        for path, one in ways.items()
    ]
    rows.sort(key=lambda row: row[0])
    head = ("path", "gains", "off the path, rms m", "largest, m", "time, s", "finished")
    return table(head, rows)


def gains(sets: dict[str, dict], results: dict[str, Tuned]) -> str:
    """The gains of every set, and between which bounds they were searched."""
    head = ("", *sets, "searched between")
    return table(head, [
        (name, *(numbers[name] for numbers in sets.values()), "{:g} and {:g}".format(*BOUNDS[name]))
        for name in NAMES
    ])  # fmt: skip


def slopes(found: dict) -> str:
    """Derivatives beside differences."""
    columns = (found[key] for key in ("names", "exact", "differences", "trend"))
    head = ("gain", "exact", "difference over 0.001 %", "difference over 2 %")
    return table(head, zip(*columns, strict=True))


def diagnosis(record: dict) -> str:
    """What was found."""
    rows = [
        (e["name"], e["parameter"], e["unit"], e["truth"], f"{e['value']:.1f} +- {e['std']:.2g}",
         ", ".join(e["alternatives"]) or "none")
        for e in record["effects"]
    ]  # fmt: skip
    head = ("effect", "parameter", "unit", "plant", "found", "cannot be told from")
    before, after = record["fit"]["nominal"]["test"], record["fit"]["diagnosed"]["test"]
    return (
        f"{table(head, rows)}\n\nVerdict: {record['verdict']}. Misfit of what was kept back, in "
        f"units of the noise: {before:.2f} with the linear model, {after:.2f} with these."
    )


def repeats(found: dict, first: dict[str, float]) -> str:
    """The joint fit on other noise, and of the older drag."""
    other, old = found["other noise"], found["older drag"]
    names = [n for n in first if n != "d"]
    rows = [
        (n, truth(NEW)[n], first[n], other["values"][n], old["truth"][n], old["values"][n],
         f"{old['stds'][n]:.2g}")
        for n in names
    ]  # fmt: skip
    rows.append(("processor time, s", None, None, other["seconds"], None, old["seconds"], ""))
    head = ("", "plant", "joint", "other noise", "older plant", "joint", "standard error")
    return table(head, rows)
