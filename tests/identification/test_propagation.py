"""How a filter's state at the next row depends on the present one, against differences."""

import jax.numpy as jnp
import numpy as np
import pytest
from tests.oracle.simulator import load
from tests.paths import ORACLE

from diffsea import Environment, read_vessel
from diffsea.identification.filter.kalman import FilterRow, propagate, propagation_jacobian
from diffsea.types import MeasuredDisturbance
from diffsea.vessel.files import build
from diffsea.vessel.servo import Response


STEP = 1e-5
WEATHER = Environment(0.2, 0.3, -4.0, 7.0, shallowness=0.4, disturbance=MeasuredDisturbance(0.05))


def row_of(boat, straight: bool) -> FilterRow:
    """A row of half a second in wind, current and shallow water."""
    response = {
        c: Response(*(0.1 * k + 0.02 * j for j in range(4))) for k, c in enumerate(boat.channels)
    }
    nothing, no = jnp.zeros(6), jnp.array(False)
    dt, t = jnp.array(0.5), jnp.array(3.0)
    known = jnp.zeros(6, bool)
    return FilterRow(
        WEATHER, dt, t, nothing, known, no, nothing, nothing, response, straight=jnp.array(straight)
    )


@pytest.mark.parametrize("straight", [False, True])
@pytest.mark.parametrize("name", ["usv", "kvlcc2"])
def test_the_next_state_depends_on_the_present_as_differences_say(name, straight):
    boat = build(load(str(ORACLE / "usv.toml"))) if name == "usv" else read_vessel(name).vessel
    row = row_of(boat, straight)
    x = jnp.array([30.0, -12.0, 0.7, 1.1, -0.2, 0.05])
    after, F = propagation_jacobian(boat, x, row, 2)
    step = lambda k, by: np.asarray(propagate(boat, x.at[k].add(by), row, 2))
    slopes = np.stack([(step(k, STEP) - step(k, -STEP)) / (2 * STEP) for k in range(6)], 1)
    np.testing.assert_allclose(after, propagate(boat, x, row, 2), rtol=1e-13)
    np.testing.assert_allclose(F, slopes, atol=1e-8 * max(1.0, np.abs(slopes).max()))
    followed = np.flatnonzero(np.abs(slopes).sum(1))
    assert list(followed) == ([0, 3] if straight else [0, 1, 2, 3, 4, 5])
