"""The layout of coordinates: what is in the model, and what is only in its room."""

import dataclasses

import jax
import numpy as np
from tests.diagnosis.small import still_problem

from diffsea import named
from diffsea.identification.coordinates import vessel_at


def test_effects_that_are_absent_are_not_in_the_vessel():
    problem = still_problem("current", "thrust-change", "heading-offset", runs=2, per_run=True)
    layout = problem.layout
    coordinates = np.zeros(layout.size)
    coordinates[1] = 0.3
    coordinates[layout.indices(("current",))[2:]] = 0.5, -0.2  # of the second run
    coordinates[layout.slices["thrust-change"].start + 1] = 4.0  # its time, and no size
    few, own = layout.present(coordinates)
    assert [effect.name for effect in few.effects] == ["current"]
    assert own.tolist() == [0.0, 0.3, 0.0, 0.0, 0.5, -0.2]
    (whole, flow), (vessel, same) = (
        vessel_at(problem.base, one, at) for one, at in ((layout, coordinates), (few, own))
    )
    numbers = {key: float(value) for key, value in named(vessel).items()}
    assert numbers.items() <= {key: float(value) for key, value in named(whole).items()}.items()
    for one, other in zip(jax.tree.leaves(flow), jax.tree.leaves(same), strict=True):
        np.testing.assert_array_equal(one, other)
    again, all_of_them = few.present(own)
    assert again == dataclasses.replace(few) and all_of_them.tolist() == own.tolist()
