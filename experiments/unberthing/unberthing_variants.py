"""Control systems that differ in one thing, and what that does on the same seeds.

Fixed before anything was run: seeds 1 to 100, each with its ship and weather; *wrong way* as in
`unberthing_scores`; *error* is the largest cross-track error of Step 2. Two systems are told apart
where an interval of 95 %, found by drawing seeds again, of the difference between them (wrong-way
shares; medians and 95th percentiles of the error) leaves out zero.
"""

from collections.abc import Mapping, Sequence

from experiments.harness.reporting import table
from experiments.unberthing.gradient_model import RATES
from experiments.unberthing.harbour_estimators import gradient, recursive
from experiments.unberthing.unberthing_scores import Score
from experiments.unberthing.unberthing_system import ControlSystem, system

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array


SLOW = 0.003  # learning rate while unberthing, a tenth of the published system's here
DRAWS = 4000
# What is left out or put in, the system without it, and the system with it.
PAIRS = (
    ("a bias in eq. 4", "published", "published, bias"),
    ("the push borne, by gradient", "published, bias", "published, bias, push borne"),
    ("a tenth of the learning rate", "published", "slow"),
    ("all three, by gradient", "published", "slow, bias, push borne"),
    ("least squares for slow gradient", "slow, bias, push borne", "no gate, push borne"),
    ("the push borne, by least squares", "no gate", "no gate, push borne"),
    ("the gate", "no gate, push borne", "trusted, push borne"),
    ("the law of fading", "no gate, no fading, push borne", "no gate, push borne"),
    ("the gate, without the law of fading",
     "no gate, no fading, push borne", "trusted, no fading, push borne"),
)  # fmt: skip


def systems() -> dict[str, ControlSystem]:
    """The control systems by name; those of one estimator share a program.

    *published* is gradient descent, *slow* with a tenth of the learning rate, *bias* with one in
    eq. 4; *trusted* is least squares behind trust and gate, *no gate* the same as it comes, *no
    fading* without the law by which thrusters fade; with *push borne* they bear the steady force.
    """
    descent, least, unfading = (
        system(estimator) for estimator in (gradient(), recursive(), recursive(fading=False))
    )

    def descending(rate: float, bias: bool, forward: bool) -> ControlSystem:
        numbers = jnp.array((rate, RATES[1])), *map(_switch, (bias, forward))
        return eqx.tree_at(
            lambda s: (s.estimator.rates, s.estimator.bias, s.estimator.forward), descent, numbers
        )

    def squares(base: ControlSystem, gated: bool, forward: bool) -> ControlSystem:
        numbers = tuple(map(_switch, (gated, forward)))
        return eqx.tree_at(lambda s: (s.estimator.gated, s.estimator.forward), base, numbers)

    return {
        "published": descending(RATES[0], False, False),
        "published, bias": descending(RATES[0], True, False),
        "published, bias, push borne": descending(RATES[0], True, True),
        "slow": descending(SLOW, False, False),
        "slow, bias, push borne": descending(SLOW, True, True),
        "trusted": squares(least, True, False),
        "no gate": squares(least, False, False),
        "trusted, push borne": squares(least, True, True),
        "no gate, push borne": squares(least, False, True),
        "trusted, no fading, push borne": squares(unfading, True, True),
        "no gate, no fading, push borne": squares(unfading, False, True),
    }


def _switch(on: bool) -> Array:
    return jnp.asarray(on, float)


def differences(judged: Mapping[str, Sequence[Score]]) -> list[dict]:
    """Each pair's difference, with minus without, over the same seeds."""
    return [
        {"part": part, "without": without, "with": own}
        | _difference(judged[without], judged[own])
        for part, without, own in PAIRS if {without, own} <= set(judged)
    ]  # fmt: skip


def _difference(without: Sequence[Score], own: Sequence[Score]) -> dict:
    wrong = np.array([[one.wrong_way > 0 for one in some] for some in (without, own)], float)
    error = np.abs([[one.worst.get(2, np.nan) for one in some] for some in (without, own)])
    drawn = np.random.default_rng(0).integers(0, wrong.shape[1], (DRAWS, wrong.shape[1]))
    measures = {
        "wrong_way": lambda rows: np.diff(wrong[:, rows].mean(-1), axis=0)[0],
        "median_error": lambda rows: np.diff(np.nanmedian(error[:, rows], -1), axis=0)[0],
        "p95_error": lambda rows: np.diff(np.nanpercentile(error[:, rows], 95, axis=-1), axis=0)[0],
    }
    found = {}
    for name, measure in measures.items():
        low, high = np.percentile(measure(drawn), [2.5, 97.5])
        found[name] = float(measure(np.arange(wrong.shape[1])))
        found[f"{name}_interval"] = [float(low), float(high)]
    return found


def differences_table(found: Sequence[dict]) -> str:
    """One row per part; bold where the interval leaves out zero."""
    head = ("put in", "runs with thrusters the wrong way", "median error", "95th percentile")
    keys = (("wrong_way", 100.0, "%"), ("median_error", 1.0, "m"), ("p95_error", 1.0, "m"))
    return table(head, [
        (one["part"],
         *(_change(one[key], one[f"{key}_interval"], factor, unit) for key, factor, unit in keys))
        for one in found
    ])  # fmt: skip


def _change(value: float, interval: Sequence[float], factor: float, unit: str) -> str:
    digits = 0 if unit == "%" else 1
    value, low, high = (factor * x for x in (value, *interval))
    text = f"{value:+.{digits}f} {unit} ({low:+.{digits}f} to {high:+.{digits}f})"
    return f"**{text}**" if low > 0 or high < 0 else text
