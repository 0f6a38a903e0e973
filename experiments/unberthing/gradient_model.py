"""The published online estimator: a linear sway-yaw model by gradient descent (eqs. 1 to 7).

Taken otherwise than printed: in eq. 4 the sway equation has the rudder where the bow thruster
must stand (Figure 7 shows gamma_vB), and in eq. 6 the prediction under the sum has the index t.
Learning rate and number of samples are not published.
"""

from experiments.unberthing.harbour_ship import PERIOD, TURNS_SQUARED, orders

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from diffsea import State, Vessel
from diffsea.types import Scalar
from diffsea.vessel.actuators.propeller import Propeller
from diffsea.vessel.hull import Damping


UPDATES = 100  # per control period, published
DELAYS = (15.0, 10.0)  # s, tau_v and tau_r, published
SAMPLES = 120  # T_r: one minute, chosen
# alpha while unberthing and while leaving. Chosen on development seeds and on Exp. 1's weather: the
# first so that thrusters turn the wrong way about when the paper's did, the second as large as
# leaves rudder control sound.
RATES = (0.03, 0.001)
TERMS = ("v", "r", "rudder", "bow", "stern", "bias")  # regressors, in this order

# Which terms the sway and the yaw equation have: eq. 4 while unberthing, eq. 5 while leaving.
UNBERTHING = ((1, 1, 0, 1, 1, 0), (1, 1, 0, 1, 1, 0))
LEAVING = ((1, 1, 1, 0, 0, 1), (1, 1, 1, 0, 0, 0))

_SHIFTS = tuple(round(delay / PERIOD) for delay in DELAYS)
_LONGEST = max(_SHIFTS)


class Linear(eqx.Module):
    """Sway and yaw one period ahead: rows (v, r), columns `TERMS` (eqs. 4 and 5)."""

    rows: Float[Array, "2 6"]

    @property
    def transition(self) -> Float[Array, "2 2"]:
        """Phi of sway and yaw."""
        return self.rows[:, :2]

    @property
    def inputs(self) -> Float[Array, "2 3"]:
        """Gamma of rudder, bow and stern thruster."""
        return self.rows[:, 2:5]


class Window(eqx.Module):
    """The last samples, the oldest first: enough for `SAMPLES` rows with their delays."""

    speeds: Float[Array, "time 2"]  # v, r
    inputs: Float[Array, "time 3"]  # delta, theta_B, theta_S that held from then on
    counted: Bool[Array, "time"]


def derivatives(
    vessel: Vessel, speed: Scalar, theta_P: Scalar
) -> tuple[Float[Array, "3 3"], Float[Array, "3 4"]]:
    """A and B of eq. 1 about a straight run: d(u, v, r)/dt by (u, v, r) and by `INPUTS` (rad)."""
    zero = jnp.zeros(())

    def rates(motion: Float[Array, "3"], blades: Float[Array, "4"]) -> Float[Array, "3"]:
        state = State(zero, zero, zero, *motion)
        return jnp.stack(vessel.acceleration(state, orders(blades), vessel.environment, zero))

    at = jnp.stack([speed, zero, zero]), jnp.stack([theta_P, zero, zero, zero])
    return jax.jacfwd(rates, 0)(*at), jax.jacfwd(rates, 1)(*at)


def discrete(
    A: Float[Array, "n n"], B: Float[Array, "n m"]
) -> tuple[Float[Array, "n n"], Float[Array, "n m"]]:
    """Eq. 3 by its series, exact to 1e-7 for the rates of ships of this size."""
    identity, M = jnp.eye(A.shape[0]), A * PERIOD
    integral = identity + M / 2 @ (identity + M / 3 @ (identity + M / 4))
    return identity + M @ integral, PERIOD * integral @ B


def linear_model(A: Float[Array, "3 3"], B: Float[Array, "3 4"], bias: Scalar = 0.0) -> Linear:
    """The sway and yaw part of a continuous model, discretised."""
    phi, gamma = discrete(A[1:, 1:], B[1:, 1:])
    return Linear(jnp.concatenate([phi, gamma, jnp.array([[bias], [0.0]])], axis=1))


def steady_blades(vessel: Vessel, speed: Scalar) -> Scalar:
    """Propeller blade angle (rad) that keeps a speed ahead in still water.

    Drag and thrust are both quadratic, so that turns go with speed: the positive root of
    `(1 - t) rho D^4 (k_0 n^2 + k_1 n V + k_2 V^2) = -X_uu` at 1 m/s, squared.
    """
    screw, damping = vessel.actuators["propeller"], vessel.forces["damping"]
    assert isinstance(screw, Propeller) and isinstance(damping, Damping)
    k0, k1, k2 = screw.k_T
    V = (1 - screw.wake_fraction) / screw.diameter
    unit = (1 - screw.thrust_deduction) * screw.water_density * screw.diameter**4
    needed = -damping.derivatives["X_uu"] / unit - k2 * V**2
    turns = (-k1 * V + jnp.sqrt((k1 * V) ** 2 + 4 * k0 * needed)) / (2 * k0)
    return (turns * speed) ** 2 / TURNS_SQUARED


@jax.jit
def nominal_linear(vessel: Vessel, speed: Scalar) -> Linear:
    """The linear model from principal particulars that estimation starts from."""
    return linear_model(*derivatives(vessel, jnp.asarray(speed), steady_blades(vessel, speed)))


def empty() -> Window:
    """Nothing measured yet."""
    rows = SAMPLES + _LONGEST
    return Window(jnp.zeros((rows, 2)), jnp.zeros((rows, 3)), jnp.zeros(rows, bool))


def push(
    window: Window, speeds: Float[Array, "2"], inputs: Float[Array, "3"], fresh: Bool[Array, ""]
) -> Window:
    """Append a measurement and what was ordered just before it; `fresh` forgets all others.

    The row of `inputs` is the one before that of `speeds`: the orders that led there.
    """
    rows = jnp.concatenate([window.inputs[1:].at[-1].set(inputs), jnp.zeros((1, 3))])
    return Window(
        jnp.concatenate([window.speeds[1:], speeds[None]]),
        rows,
        jnp.concatenate([window.counted[1:] & ~fresh, ~fresh[None]]),
    )


def normal_equations(
    window: Window, equation: int, terms: Float[Array, "6"]
) -> tuple[Float[Array, "6 6"], Float[Array, "6"]]:
    """Mean of x x' and of x y over the window for the sway (0) or yaw (1) equation."""
    first = _LONGEST - _SHIFTS[equation]
    y = window.speeds[_LONGEST:, equation]
    delayed = window.inputs[first : first + SAMPLES]
    one = jnp.ones((SAMPLES, 1))
    x = jnp.concatenate([window.speeds[_LONGEST - 1 : -1], delayed, one], axis=1) * terms
    x = x * window.counted[_LONGEST:, None]
    return x.T @ x / SAMPLES, x.T @ y / SAMPLES


def descended(
    theta: Float[Array, "6"], G: Float[Array, "6 6"], b: Float[Array, "6"], rate: Scalar
) -> Float[Array, "6"]:
    """`UPDATES` steps of eq. 7 on the mean square error, `theta' G theta - 2 b' theta` and more.

    One step is the affine map `theta - 2 rate (G theta - b)`; its powers by squaring are the same
    steps for a fraction of the work.
    """
    M, c = jnp.eye(6) - 2 * rate * G, 2 * rate * b
    power = UPDATES
    while power:
        if power % 2:
            theta = M @ theta + c
        M, c, power = M @ M, M @ c + c, power // 2
    return theta


def estimated(
    model: Linear,
    window: Window,
    leaving: Bool[Array, ""],
    rates: Float[Array, "2"],
    bias: Scalar = 0.0,
) -> Linear:
    """The model after one control period of gradient descent; `bias`, 0 or 1: eq. 4 has one."""
    rows, rate = [], jnp.where(leaving, rates[1], rates[0])
    for k in range(2):
        unberthing = jnp.array(UNBERTHING[k], float).at[5].set(bias)
        terms = jnp.where(leaving, jnp.array(LEAVING[k], float), unberthing)
        rows.append(descended(model.rows[k], *normal_equations(window, k, terms), rate))
    return Linear(jnp.stack(rows))
