# pyright: reportArgumentType=false
"""The prior of effects' sizes: scipy's multivariate Student t about zero, normal elsewhere."""

import numpy as np
import pytest
from scipy import stats
from tests.oracle.simulator import load
from tests.paths import ORACLE

from diffsea import EFFECTS, Parameter
from diffsea.identification.coordinates import TAIL_DEGREES, CoordinateLayout
from diffsea.vessel.effects.coordinates import PRIOR_SPREAD
from diffsea.vessel.files import build


NAMES = ("drag-change", "current", "gyro-bias")  # a size and a time, a vector, a number


@pytest.fixture(scope="module")
def layout():
    vessel = build(load(ORACLE / "usv.toml"))
    effects = tuple(EFFECTS[name] for name in NAMES)
    sizes = tuple(effect.sizes(vessel) for effect in effects)
    return CoordinateLayout((Parameter("X_u", -50.0, 25.0),), effects, sizes, 3, True, 100.0)


def student(d):
    """Of the same curvature at its centre as a normal one of `SPREAD`."""
    return stats.multivariate_t(
        np.zeros(d),
        PRIOR_SPREAD**2 * (TAIL_DEGREES + d) / TAIL_DEGREES * np.eye(d),
        df=TAIL_DEGREES,
    )


def cost(layout, x):
    """-2 log of the density over that at the centre."""
    return float((np.asarray(layout.strains(x, layout.spreads())) ** 2).sum())


@pytest.mark.parametrize("scale", [0.01, 1.0, 30.0])
def test_sizes_have_the_tail_of_a_student_t(layout, scale):
    x = scale * np.random.default_rng(1).normal(size=layout.size)
    factor, time = x[layout.slices["drag-change"]]
    currents = x[layout.slices["current"]].reshape(3, 2)
    tails = [(1, [factor]), (1, x[layout.slices["gyro-bias"]]), *((2, c) for c in currents)]
    normal = (x[0] / layout.spreads()[0]) ** 2
    normal += (time / layout.spreads()[layout.slices["drag-change"]][1]) ** 2
    heavy = sum(2 * (student(d).logpdf(np.zeros(d)) - student(d).logpdf(c)) for d, c in tails)
    assert cost(layout, x) == pytest.approx(normal + heavy, rel=1e-9)


def test_the_centre_of_a_student_t_is_lower_than_that_of_a_normal(layout):
    normal = lambda d: stats.multivariate_normal(np.zeros(d), PRIOR_SPREAD**2 * np.eye(d))
    for effect, copies, d in zip(layout.effects, (1, 3, 1), (1, 2, 1), strict=True):
        centre = np.zeros(d)
        lower = 2 * copies * (normal(d).logpdf(centre) - student(d).logpdf(centre))
        assert layout.tail_cost(effect, copies) == pytest.approx(lower)


def test_local_spreads_have_the_slope_of_the_prior(layout):
    x = 4.0 * np.random.default_rng(2).normal(size=layout.size)
    steps = 1e-6 * np.eye(layout.size)
    slope = [(cost(layout, x + h) - cost(layout, x - h)) / 2e-6 for h in steps]
    assert 2 * x / layout.local_spreads(x) ** 2 == pytest.approx(slope, rel=1e-4)


def test_a_size_far_out_in_the_tail_hardly_counts(layout):
    x = np.zeros(layout.size)
    x[layout.slices["gyro-bias"]] = 100 * PRIOR_SPREAD
    assert cost(layout, x) < 35  # of 10 000 of a normal one


@pytest.mark.parametrize(
    ("time", "within"), [(0.5, False), (3.0, False), (6.0, True), (97.0, False)]
)
def test_a_change_has_data_before_and_after_it(time, within):
    effect = EFFECTS["drag-change"]
    assert effect.scanned is not None
    assert effect.scanned[1].lies_within(time, np.linspace(0.0, 100.0, 1001)) == within


def test_a_vessel_loses_at_most_half_of_its_mass_and_gains_at_most_itself():
    vessel = build(load(ORACLE / "usv.toml"))
    mass = float(vessel.rigid_body.mass)
    assert EFFECTS["mass-change"].bounds(vessel)[0] == (-0.5 * mass, mass)
