"""The sweep itself through `diffsea.studies.sweep`, and what the maps show of it."""

import time
from typing import NamedTuple

from experiments.design_sweep.loading import KINDS, Kind, axes, designs, plan
from experiments.harness.reporting import Experiment

import numpy as np
import pandas as pd
from jaxtyping import Float

from diffsea import Vessel
from diffsea.studies import sweep


# Panel: title, kind, column of the table, unit, IMO limit, its section of MSC.137(76).
LENGTH, ANGLE = "L", "deg"
KEPT = (
    "thrust", "mass", "advance", "transfer", "tactical_diameter", "initial_turning_distance",
    "overshoot_1", "overshoot_2", "peak_yaw_rate", "approach_speed",
)  # fmt: skip
PANELS = (
    ("tactical diameter", 0, "tactical_diameter", LENGTH, 5.0, "5.3.1"),
    ("advance", 0, "advance", LENGTH, 4.5, "5.3.1"),
    ("initial turning, 10/10", 1, "initial_turning_distance", LENGTH, 2.5, "5.3.2"),
    ("first overshoot, 10/10", 1, "overshoot_1", ANGLE, 10.0, "5.3.3.1"),
    ("second overshoot, 10/10", 1, "overshoot_2", ANGLE, 25.0, "5.3.3.2"),
    ("first overshoot, 20/20", 2, "overshoot_1", ANGLE, 25.0, "5.3.3.3"),
)


class Swept(NamedTuple):
    """Tables by trial, in rows of thrust by mass, and how fast they were made."""

    thrust: Float[np.ndarray, "thrust"]  # N
    mass: Float[np.ndarray, "mass"]  # kg
    tables: dict[str, pd.DataFrame]
    rates: dict[str, float]  # vessel-steps per second
    seconds: dict[str, float]  # with compiling

    def column(self, kind: Kind, name: str) -> Float[np.ndarray, "mass thrust"]:
        """A column of a table as a map."""
        return self.tables[kind.label][name].to_numpy().reshape(self.mass.size, self.thrust.size)


def swept(run: Experiment, vessel: Vessel, size: tuple[int, int], kinds: tuple[Kind, ...]) -> Swept:
    """All designs of a grid of thrusts by masses through some trials."""
    thrust, mass = axes(*size)
    pairs = np.meshgrid(thrust, mass)
    table = designs(vessel, pairs[0].ravel(), pairs[1].ravel())
    tables, rates, seconds = {}, {}, {}
    for kind in kinds:
        began = time.perf_counter()
        rows, rates[kind.label] = sweep.sweep(vessel, plan(vessel, kind), table)
        tables[kind.label] = slimmed(rows)
        seconds[kind.label] = time.perf_counter() - began
        rate, took = rates[kind.label], seconds[kind.label]
        run.say(f"{kind.label}: {len(table.values)} designs in {took:.0f} s, {rate:.2g} steps/s")
    return Swept(thrust, mass, tables, rates, seconds)


def slimmed(table: pd.DataFrame) -> pd.DataFrame:
    """The columns that are shown or compared; words as categories."""
    words = [name for name in table if name == "outcome" or str(name).startswith("imo_")]
    kept = [name for name in KEPT if name in table]
    return pd.concat([table[kept], table[words].astype("category")], axis=1)


def rate(vessel: Vessel, kind: Kind, count: int) -> float:
    """Vessel-steps per second of a sweep of some designs, compiled before."""
    pairs = np.meshgrid(*axes(count, count))
    table = designs(vessel, pairs[0].ravel(), pairs[1].ravel())
    return sweep.sweep(vessel, plan(vessel, kind), table)[1]


def in_units(values: np.ndarray, unit: str, length: float) -> np.ndarray:
    """Metres over the length (m), radians in degrees."""
    return values / length if unit == LENGTH else np.degrees(values)


def criteria(found: Swept, length: float) -> list[dict]:
    """Range of every number with an IMO limit, and the share of designs within it."""
    rows = []
    for title, k, name, unit, limit, section in PANELS:
        kind = KINDS[k]
        if kind.label not in found.tables:
            continue
        values = in_units(found.column(kind, name), unit, length)
        rows.append(
            {
                "criterion": title, "unit": unit, "limit": limit, "section": section,
                "least": np.nanmin(values), "most": np.nanmax(values),
                "share_pass": float(np.mean(values <= limit)),
            }
        )  # fmt: skip
    return rows


def compliant(found: Swept) -> np.ndarray:
    """Which designs pass every criterion of every trial."""
    shape = (found.mass.size, found.thrust.size)
    verdict = np.ones(shape, bool)
    for table in found.tables.values():
        for name in table:
            if str(name).startswith("imo_"):
                verdict &= (table[name] == "pass").to_numpy().reshape(shape)
    return verdict
