"""What a fit says of one side's thrust against the other's, against draws from its posterior."""

import numpy as np
import pytest
from tests.diagnosis.small import DOCUMENT, still_run

from diffsea.identification.estimates import posterior_estimate
from diffsea.identification.problem import make_problem
from diffsea.identification.uncertainty.sides import SHARES, differing_sides
from diffsea.report.wording.caveats import side_sentences
from diffsea.vessel.files import build


CURVE = {"full_thrust": 60.0, "exponent": 1.5, "astern_ratio": 0.7}
NUMBERS = [f"{side}.thrust_curve.{number}" for side in ("port", "starboard")
           for number in ("full_thrust", "exponent")]  # fmt: skip
COMMON = np.array([1.0, 0.0, 1.0, 0.0]) / np.sqrt(2)


def twin(free, y=0.5):
    """A problem of a craft with two thrusters that follow curves, at rest."""
    document = {name: DOCUMENT[name] for name in ("name", "hull")} | {"format": 1}
    document["thruster"] = [
        {"name": name, "x": -1.6, "y": place, "unit": "normalised", "neutral": 0.0,
         "full_ahead": 1.0, "full_astern": -1.0, "thrust_curve": CURVE}
        for name, place in (("port", -0.5), ("starboard", y))
    ]  # fmt: skip
    vessel = build(document)
    return make_problem(vessel, [still_run(vessel)], free)


def fitted(problem, values, std=0.01, common=2.0):
    """An estimate at some coordinates by name; what moves both thrusts alike is badly known."""
    size, index = problem.layout.size, np.array(problem.layout.indices(problem_names(problem)))
    coordinates = np.zeros(size)
    for name, value in values.items():
        coordinates[problem.layout.indices((name,))[0]] = value
    order = [
        problem_names(problem).index(name) for name in NUMBERS if name in problem_names(problem)
    ]
    covariance = std**2 * np.eye(len(order))
    if len(order) == 4:
        covariance += common**2 * np.outer(COMMON, COMMON)
    whole = np.zeros_like(covariance)
    whole[np.ix_(order, order)] = covariance
    estimate = posterior_estimate(
        problem_names(problem), coordinates, 0.0, index, np.full(size, 1e3), np.linalg.inv(whole)
    )
    return estimate


def problem_names(problem):
    return tuple(parameter.name for parameter in problem.layout.parameters)


def test_a_weaker_side_is_told_with_the_error_of_the_ratio_alone():
    problem = twin(tuple(NUMBERS))
    estimate = fitted(problem, {"starboard.thrust_curve.full_thrust": np.log(0.78)})
    (found,) = differing_sides(problem, estimate)
    assert (found.weaker, found.stronger) == ("starboard", "port")
    assert found.ratio == pytest.approx(0.78, rel=1e-6)
    draws = np.random.default_rng(0).multivariate_normal(
        estimate.coordinates[estimate.index], estimate.covariance, 200_000
    )
    at = {name: draws[:, k] for k, name in enumerate(problem_names(problem))}
    thrust = {
        side: CURVE["full_thrust"]
        * np.exp(at[f"{side}.thrust_curve.full_thrust"])[:, None]
        * SHARES ** (CURVE["exponent"] * np.exp(at[f"{side}.thrust_curve.exponent"]))[:, None]
        for side in ("port", "starboard")
    }
    stds = np.std(np.log(thrust["starboard"] / thrust["port"]), axis=0)
    assert SHARES[np.argmin(stds)] == found.share
    assert found.std / found.ratio == pytest.approx(stds.min(), rel=0.01)
    (sentence,) = side_sentences([found._asdict()])
    assert "starboard pushes 0.78 +- 0.01 times as much as port at" in sentence


@pytest.mark.parametrize(
    ("size", "std"), [(np.log(0.78), 0.2), (np.log(0.98), 0.001)], ids=["uncertain", "little"]
)
def test_what_is_uncertain_or_little_is_not_told(size, std):
    problem = twin(tuple(NUMBERS))
    estimate = fitted(problem, {"starboard.thrust_curve.full_thrust": size}, std)
    assert differing_sides(problem, estimate) == []


@pytest.mark.parametrize("free, y", [(NUMBERS[:2], 0.5), (NUMBERS, 0.4)], ids=["held", "elsewhere"])
def test_sides_that_are_not_both_free_or_no_mirror_images_are_not_compared(free, y):
    problem = twin(tuple(free), y)
    estimate = fitted(problem, {"port.thrust_curve.full_thrust": np.log(0.5)})
    assert differing_sides(problem, estimate) == []
