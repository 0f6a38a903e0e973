"""What others measured and no diagnosis sees: Kingfisher's bollard curve, Esso Osaka's wind."""

import math

from experiments.concealed_real import logs, sets
from experiments.concealed_real.checks import Line, stem
from experiments.concealed_real.material import Document

import numpy as np
import pandas as pd


DEGREE = math.pi / 180


def thrust_of(document: Document, order: float) -> float:
    """Thrust (N) at rest of Kingfisher's port thruster at an order ahead in N, after a diagnosis.

    By the laws that the catalogue of effects states.
    """
    part = next(p for p in document["thruster"] if p["name"] == "port")
    acting = max(order - part.get("deadband", 0.0), 0.0)
    gain, full = 1.0, part["max_force"]
    for effect in document.get("effect", []):
        if "port" not in effect.get("actuators", ["port"]):
            continue
        if effect["name"] == "deadband":
            acting = max(acting - effect["width"], 0.0)
        elif effect["name"] == "thrust-saturation":
            acting = min(acting, effect["limit"])
        elif effect["name"] == "thrust-curve":
            acting *= (1 + (acting / effect.get("limit", math.inf)) ** 8) ** (-1 / 8)
            acting = max(acting - effect.get("deadband", 0.0), 0.0)
            acting = full * (acting / full) ** effect.get("exponent", 1.0)
            gain *= effect.get("gain", 1.0)
    return gain * acting


def thrust_is_measured(line: Line) -> bool:
    """Whether thrust is within 20 % of the bollard curve, or 1 N, at 0.2 to 1 of full ahead."""
    curve = pd.read_csv(sets.DATA / "kingfisher_nps_2017" / "tcurve.csv").to_numpy()
    ahead = curve[curve[:, 0] >= 0.2]
    found = np.array([thrust_of(line["vessel"], logs.AHEAD * c) for c in ahead[:, 0]])
    return bool(np.all(np.abs(found - ahead[:, 1]) <= np.maximum(0.2 * ahead[:, 1], 1.0)))


def winds() -> dict[str, tuple[float, float]]:
    """Mean measured wind of every Esso Osaka run: speed (m/s) and direction (rad, from)."""
    found = {}
    for file in sorted((sets.DATA / "esso_osaka" / "measured_wind").glob("*.csv")):
        table = pd.read_csv(file)
        speed = table["wind_velo_true [m/s]"].to_numpy()
        mean = np.mean(speed * np.exp(1j * table["wind_dir_true [rad]"].to_numpy()))
        found[file.stem] = (float(abs(mean)), float(np.angle(mean)))
    return found


def wind_errors(line: Line) -> list[tuple[float, float]]:
    """Of every run's wind that is named: error of the direction (rad), relative one of speed."""
    true, errors = winds(), []
    for effect in line["effects"]:
        where = stem(effect.get("recording", ""))
        if effect["name"] == "wind" and where in true:
            speed, direction = (effect["parameters"][k]["value"] for k in ("speed", "direction"))
            off = (direction - true[where][1] + math.pi) % (2 * math.pi) - math.pi
            errors.append((abs(off), abs(speed / true[where][0] - 1)))
    return errors


def wind_direction_is_measured(line: Line) -> bool:
    """Half of the runs' directions within 20 deg."""
    errors = [direction for direction, _ in wind_errors(line)]
    return bool(errors) and float(np.median(errors)) <= 20 * DEGREE


def wind_speed_is_measured(line: Line) -> bool:
    """Half of the runs' speeds within a quarter."""
    errors = [speed for _, speed in wind_errors(line)]
    return bool(errors) and float(np.median(errors)) <= 0.25
