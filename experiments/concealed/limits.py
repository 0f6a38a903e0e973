"""Detection limits: the size of each effect that a hull's manoeuvres could just show.

With the simulator alone. The deviation that an effect makes in the readings of the four training
runs, orders replayed, is whitened by a Kalman filter linearised along the run (gusts as forces of
an Ornstein-Uhlenbeck process, sensor noise, unknown initial state). What the nuisances (damping
derivatives and added masses, 25 % prior) can mimic is projected out. The length of what is left
is the effect's size in standard deviations; the detection limit is the size at which it is 3.

    python -m experiments.concealed.limits [HULL ...]     writes limits.json
"""

import json
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from . import draw, effects, orders, outside
from .hulls import HULLS, Hull
from .model import Model
from .sensors import GROUPS, true_readings
from .simulate import CHANNELS, Track, _motion, derivative, simulate


SIGMA = 3.0  # standard deviations that count as seen
STEP = 1e-3  # relative, to either side, for the nuisances' derivatives
FAINT = 0.15  # standard deviations: a trace of which a derivative is taken
ABRUPT = ("thrust-saturation",)  # nothing happens up to some size: no derivative at zero
SEED = 77  # of the manoeuvres
MEASURED = CHANNELS[:6]


@dataclass
class Filter:
    """Gains of one run: transition, output matrix, gain and Cholesky factor at each row."""

    steps: list[tuple]

    def whiten(self, deviation: np.ndarray) -> np.ndarray:
        """Whitened innovations (values,) of a deviation (rows, channels) of the readings."""
        state, out = np.zeros(9), []
        for k, (Phi, H, there, gain, factor) in enumerate(self.steps):
            e = deviation[k, there] - H @ state
            out.append(solve_triangular(factor, e, lower=True, check_finite=False))
            state = Phi @ (state + gain @ e)
        return np.concatenate(out)


def detection_limits(
    hull: Hull, tell=print, only: tuple[str, ...] | None = None, start: dict | None = None
) -> dict[str, float]:
    """Limit of every effect (or those in `only`) of the hull, by key, in the unit of its size.

    Without those that not even their largest plausible size shows. `start` has guesses by key.
    """
    start = start or {}
    rng = np.random.default_rng(SEED)
    model = outside.true_model(hull, rng, 0.0)
    policies = orders.full(rng, hull, model.sensing)[:4]
    replays = [orders.Replay(_still(model, hull, p).orders) for p in policies]
    tracks = [_still(model, hull, p) for p in replays]
    readings = lambda m: [_readings(m, hull, p) for p in replays]
    before = readings(model)
    filters = [_filter(model, hull, t) for t in tracks]

    def whitened(m: Model) -> np.ndarray:
        pairs = zip(readings(m), before, filters, strict=True)
        return np.concatenate([f.whiten(a - b) for a, b, f in pairs])

    def changed(name: str, value: float) -> np.ndarray:
        nuisance = model.copy()
        nuisance.hull[name] = value
        return whitened(nuisance)

    # Orders replayed, runs drift apart: a change of two per cent is no derivative any more.
    columns = [
        (changed(name, value * (1 + STEP)) - changed(name, value * (1 - STEP))) / (2 * STEP)
        for name, value in _nuisances(model)
    ]
    J = np.column_stack(columns)  # for a relative change of one
    normal = cho_factor(J.T @ J + np.eye(J.shape[1]) / outside.SPREAD**2)

    def trace(effect: effects.Effect, extra: dict, size: float) -> np.ndarray:
        """Whitened deviation that a size makes; what no size at all does is none of it."""
        traces = []
        for amount in (size, 1e-6 * size):
            with_it = model.copy()
            effect.put(with_it, hull, amount, extra)
            traces.append(whitened(with_it))
        return traces[0] - traces[1]

    def unlike(a: np.ndarray) -> float:
        """Length of what the nuisances cannot mimic, in standard deviations."""
        b = J.T @ a
        return math.sqrt(max(float(a @ a - b @ cho_solve(normal, b)), 0.0))

    def limit(effect: effects.Effect, first: float) -> float:
        """Infinite where not even the largest plausible size is seen."""
        extra = effects.typical_extra(effect, hull)
        at = lambda size: trace(effect, extra, size)
        if effect.name in ABRUPT:
            size, length = search(lambda s: unlike(at(s)), first, effect.most, SIGMA, 1.01)
            return size if length > 0.99 * SIGMA else math.inf
        # Far off, runs drift apart in ways that a filter would follow: a derivative counts.
        small = lambda s: float(np.linalg.norm(at(s)))
        size, length = search(small, FAINT * first, 0.5 * effect.most, FAINT, 1.5)
        if length < FAINT / 1.5:
            return math.inf
        length = unlike(2 * at(size) - 0.5 * at(2 * size))
        return size * SIGMA / length if length > 0.0 else math.inf

    found = {}
    for key, effect in effects.catalogue(hull).items():
        if only is not None and key not in only:
            continue
        size = limit(effect, min(start.get(key, effect.first), effect.most))
        if math.isfinite(size):
            found[key] = float(f"{size:.4g}")
        tell(f"{hull.name} {key}: {size:.4g} (largest {effect.most:.4g})")
    return found


def search(
    length: Callable[[float], float], size: float, most: float, aim: float, near: float
) -> tuple[float, float]:
    """A size whose `length` is `aim` or up to `near` times more or less, and that length.

    In proportion until the aim lies between two sizes, then by halves in the logarithm: a
    response may be flat at first and steep later. (`most`, its length) where that is short of it.
    """
    low, high = 0.0, math.inf
    size = min(size, most)
    for _ in range(60):
        found = length(size)
        if aim / near <= found <= aim * near or (size >= most and found < aim):
            break
        low, high = (size, high) if found < aim else (low, size)
        if low > 0.0 and high < math.inf:
            size = math.sqrt(low * high)
        else:
            size = min(size * min(max(aim / max(found, 1e-9), 0.01), 10.0), most)
    return size, found


def _nuisances(model: Model) -> list[tuple[str, float]]:
    """Damping derivatives and added masses."""
    known = ("length", "beam", "draught", "mass", "x_G", "I_z", "water_density")
    return [(k, v) for k, v in model.hull.items() if isinstance(v, float) and v and k not in known]


def _still(model: Model, hull: Hull, policy) -> Track:
    """A run without gusts."""
    lead = round(hull.lead / hull.step)
    return simulate(model, policy, hull.rows, hull.step, lead, (0.0, 0.0, 0.3, 0.5 * hull.speed))


def _readings(model: Model, hull: Hull, policy) -> np.ndarray:
    """Noise-free readings (rows, six channels)."""
    t = np.arange(hull.rows) * hull.step
    found = true_readings(_still(model, hull, policy), model.sensing, t)
    return np.column_stack([found[c] for c in MEASURED])


def _filter(model: Model, hull: Hull, track: Track) -> Filter:
    """The Kalman filter along a run: six impulses and three gust forces."""
    z = track.impulses[np.searchsorted(track.t, -1e-9) :: 2]
    h = hull.document["hull"]
    gust = h["mass"] * hull.gust * np.array([1.0, 1.0, 0.25 * h["length"]])
    keep = math.exp(-hull.step / hull.gust_time)
    Q = np.diag([0.0] * 6 + list((1.0 - keep**2) * gust**2))
    std, every = _noise(hull)
    inertia, f = derivative(model, _held(track, model), None, 0.0)
    P = np.diag([25.0, 25.0, 1.0, *(h["mass"] * hull.speed * np.array([1, 1, h["length"]])) ** 2,
                 *gust**2])  # fmt: skip
    steps = []
    for k in range(hull.rows):
        Phi = _transition(f, inertia, z[k], hull, k)
        H = np.hstack([_outputs(model, inertia, z[k]), np.zeros((6, 3))])
        there = np.flatnonzero(k % every == 0)
        H = H[there]
        S = H @ P @ H.T + np.diag(std[there] ** 2)
        factor = np.linalg.cholesky(S)
        gain = cho_solve((factor, True), H @ P).T
        steps.append((Phi, H, there, gain, factor))
        P = P - gain @ S @ gain.T
        P = Phi @ (0.5 * (P + P.T)) @ Phi.T + Q
    return Filter(steps)


def _held(track: Track, model: Model) -> dict:
    """Servos that have heard the whole run's orders."""
    from .actuation import Servo

    rows = len(track.orders)
    step = (track.t[-1] - 0.0) / (rows - 1)
    servos = {}
    for i, label in enumerate(track.labels):
        servos[label] = Servo(model.channel(label), float(track.orders[0, i]))
        for k in range(rows):
            servos[label].order(k * step, float(track.orders[k, i]))
    return servos


def _noise(hull: Hull) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviation and rows between readings of the six channels."""
    of = {c: hull.instruments[g] for g, cs in GROUPS.items() for c in cs if g in hull.instruments}
    rounding = lambda i: i.quantum / math.sqrt(12.0)
    std = [math.hypot(of[c].std, rounding(of[c])) for c in MEASURED]
    return np.array(std), np.array([of[c].every for c in MEASURED])


def _transition(f, inertia, z: np.ndarray, hull: Hull, k: int) -> np.ndarray:
    """Exponential of the augmented Jacobian over one row, by central differences (9, 9)."""
    t = k * hull.step + 1e-6
    A = np.zeros((9, 9))
    m, v = inertia.m11, hull.speed
    size = 1e-5 * np.array([1.0, 1.0, 1.0, m * v, m * v, inertia.m33 * v])
    for i in range(6):
        up, down = z.copy(), z.copy()
        up[i] += size[i]
        down[i] -= size[i]
        A[:6, i] = (np.array(f(up, t)[:6]) - np.array(f(down, t)[:6])) / (2.0 * size[i])
    c, s = math.cos(z[2]), math.sin(z[2])
    A[3:6, 6:9] = [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]
    A[6:, 6:] = -np.eye(3) / hull.gust_time
    return exponential(A * hull.step)


def exponential(A: np.ndarray) -> np.ndarray:
    """exp(A) of a small matrix: eight terms at an eighth, squared thrice."""
    B = A / 8.0
    term = total = np.eye(len(A))
    for k in range(1, 9):
        term = term @ B / k
        total = total + term
    for _ in range(3):
        total = total @ total
    return total


def _outputs(model: Model, inertia, z: np.ndarray) -> np.ndarray:
    """Derivative of the six channels by the six impulses."""
    size = 1e-6 * np.maximum(np.abs(z[:6]), 1.0)
    both = np.concatenate([z + np.eye(10)[:6] * size[:, None], z - np.eye(10)[:6] * size[:, None]])
    y = _motion(model, inertia, both)[:, :6]
    return ((y[:6] - y[6:]) / (2.0 * size[:, None])).T


def main() -> None:
    """Compute the limits of the hulls named (default: all) and write them."""
    path = draw.LIMITS
    found = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    for name in sys.argv[1:] or HULLS:
        guess = found.get(name, {}).get("limits")
        limits = detection_limits(HULLS[name], lambda m: print(m, flush=True), start=guess)
        found[name] = {
            "seed": SEED, "sigma": SIGMA, "of": draw.digest(HULLS[name]), "limits": limits,
        }  # fmt: skip
        path.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
