# pyright: reportArgumentType=false
"""Online estimation on simulated runs: convergence, a change of drag, and a faulty compass.

The runs come from the independent simulator of the tests, which shares no code with the library.
"""

import json
from pathlib import Path

from diffsea.runtime import prepare_jax


prepare_jax()

ROOT = Path(__file__).resolve().parents[2]

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.axes
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from tests.oracle import sensors
from tests.oracle.make_recordings import MASSES, gust_scale, perform, perturbed, stream
from tests.oracle.simulator import load

from diffsea import State, Trajectory, Vessel
from diffsea.identification.filter.covariance import Noise
from diffsea.identification.online.ekf import ExtendedKalmanFilter, KalmanBelief, kalman_filter
from diffsea.identification.online.guarded import OnlineRun, run_least_squares, run_online
from diffsea.trajectory import MOTION_CHANNELS
from diffsea.vessel.files import build


FREE = ("X_u", "X_uu", "Y_v", "N_r", "N_rr")
RESULTS = Path(__file__).with_name("results.json")
SECONDS, RATE, SEEDS = 240.0, 5.0, range(1, 11)
DRIFT = 1e-3  # per sqrt(s): 3 % of the prior's spread in the length of a run
FAULT = (100.0, 130.0)  # s
CHANGE = {"drag-change": {"time": 100.0, "factor": 0.5}}


def truth(document: dict, seed: int) -> dict:
    """A vessel with derivatives 15 to 25 % off the file's; masses, the scale, stay."""
    true = perturbed(document, stream(seed, "hull"))
    true["hull"] |= {name: document["hull"][name] for name in MASSES if name in document["hull"]}
    return true


def recorded(true: dict, seed: int, name: str, effects: dict | None = None) -> Trajectory:
    """One noisy run."""
    sim = perform(true, name, seed, effects, SECONDS, RATE)
    t = np.arange(int(SECONDS * RATE) + 1) / RATE
    rec = sensors.record(sim, t, sensors.suite(), stream(seed, name, "noise"))
    return Trajectory(
        t, **{c: np.asarray(rec[c]) for c in MOTION_CHANNELS},
        commanded={c: np.asarray(rec[f"cmd_{c}"]) for c in ("port", "starboard")},
        executed={}, extra={}, valid=np.ones(len(t), bool), name=f"{name}-{seed}",
    )  # fmt: skip


def with_frozen_heading(recording: Trajectory) -> Trajectory:
    """The same with a compass that stands still for a while."""
    psi, t = np.array(recording.psi), np.asarray(recording.t)
    during = (t >= FAULT[0]) & (t < FAULT[1])
    psi[during] = psi[during.argmax()]
    return Trajectory(**{**vars(recording), "psi": psi})


def noise(true: dict) -> Noise:
    """The simulator's own."""
    std = gust_scale(true)
    sensor = [part.noise for part in sensors.suite().values()]
    scales = 1e-3 * std, std, [5.0, 5.0, 3.0], sensor, [1e-9]
    return Noise(*(jnp.log(jnp.asarray(x)) for x in scales))


@eqx.filter_jit
def _filtered(filter: ExtendedKalmanFilter, belief: KalmanBelief, rows: tuple) -> tuple:
    def body(now: KalmanBelief, row: tuple) -> tuple:
        now, _ = filter.step(now, *row)
        return now, now.coordinates

    return jax.lax.scan(body, belief, rows)[1]


def bare(vessel: Vessel, recording: Trajectory, true: dict) -> dict:
    """Estimates of the filter alone, which never starts again."""
    motion = np.stack([getattr(recording, c) for c in MOTION_CHANNELS], -1)
    filter = kalman_filter(vessel, FREE, noise(true), drift=DRIFT)
    belief = filter.init(State(*motion[0]))
    held = {c: np.append(x[:1], x[:-1]) for c, x in recording.commanded.items()}
    rows = held, motion, np.diff(recording.t, prepend=0.0)
    found = np.asarray(_filtered(filter, belief, jax.tree.map(jnp.asarray, rows)))
    return {p.name: p.decode(found[:, k]) for k, p in enumerate(filter.parameters)}


def errors(values: dict, true: dict, since: float, run: OnlineRun) -> float:
    """Largest relative error of any parameter from a time on."""
    late = run.t >= since
    return max(float(np.abs(values[n][late] / true["hull"][n] - 1).max()) for n in FREE)


def blocked(run: OnlineRun) -> float:
    """Share of the time after the first minute in which the gate was closed."""
    return float(1 - run.open[run.t > 60].mean())


def main() -> None:
    """Run the three studies, print and write the figures."""
    document = load(ROOT / "tests" / "oracle" / "usv.toml")
    vessel = build(document)
    figures: dict[str, list] = {"clean": [], "changed": [], "fault": []}
    shown: dict[str, tuple] = {}
    for seed in SEEDS:
        true = truth(document, seed)

        def study(recording: Trajectory, true: dict = true) -> OnlineRun:
            return run_online(vessel, recording, FREE, noise=noise(true), drift=DRIFT)

        name = ("random-fast", "zigzag-fast")[seed % 2]
        clean = recorded(true, seed, name)
        run = study(clean)
        least = run_least_squares(vessel, clean, FREE)
        off = [[(r.estimate[n][-1] - true["hull"][n]) / r.std[n][-1] for n in FREE]
               for r in (run, least)]  # fmt: skip
        figures["clean"].append({
            "manoeuvre": name, "off_ekf": off[0], "off_rls": off[1],
            "yaw_error": abs(run.estimate["N_r"][-1] / true["hull"]["N_r"] - 1),
            "nis": run.nis[25:].sum() / run.degrees[25:].sum(), "blocked": blocked(run),
        })  # fmt: skip
        changed = study(recorded(true, seed, name, CHANGE))
        closed = (changed.t > 100) & ~changed.open
        figures["changed"].append({
            "found": changed.t[closed][0] - 100 if closed.any() else None,
            "closed": closed.sum() / RATE,
            "N_r": changed.handed["N_r"][-1] / true["hull"]["N_r"],
            "Y_v": changed.handed["Y_v"][-1] / true["hull"]["Y_v"],
        })  # fmt: skip
        frozen = with_frozen_heading(clean)
        fault = study(frozen)
        closed = (fault.t >= FAULT[0]) & ~fault.open
        figures["fault"].append({
            "found": fault.t[closed][0] - FAULT[0] if closed.any() else None,
            "filter_alone": errors(bare(vessel, frozen, true), true, FAULT[0], fault),
            "without_fault": errors(run.handed, true, FAULT[0], run),
            "with_gate": errors(fault.handed, true, FAULT[0], fault),
            "nominal": max(abs(document["hull"][n] / true["hull"][n] - 1) for n in FREE),
            "reason": fault.reasons(int(np.argmax(closed)))[0] if closed.any() else None,
        })  # fmt: skip
        if seed == 1:
            shown = {"clean": (run, least), "changed": (changed,), "fault": (fault,)}
            draw(shown, true, document)
    write(figures)


def write(figures: dict[str, list]) -> None:
    """Print the summary and write it with every figure beside the README."""
    told = {"summary": summary(figures), **figures}
    text = json.dumps(told, indent=1, default=lambda x: np.asarray(x).tolist())
    RESULTS.write_text(text + "\n", encoding="utf-8")
    print(json.dumps(told["summary"], indent=1))


def summary(figures: dict[str, list]) -> dict:
    """What the README tells: ranges and medians over the craft."""

    def column(study: str, key: str) -> np.ndarray:
        return np.array([row[key] for row in figures[study]], float)

    def over_craft(study: str, *keys: str) -> dict:
        named = {key: column(study, key) for key in keys}
        return {
            key: {"least": x.min(), "median": np.median(x), "largest": x.max()}
            for key, x in named.items()
        }

    convergence = {
        kind: {"rms": np.sqrt(np.mean(off**2)), "largest": np.abs(off).max()}
        for kind in ("off_ekf", "off_rls")
        for off in (column("clean", kind),)
    }
    told = convergence | {
        "clean": over_craft("clean", "nis", "yaw_error", "blocked"),
        "changed": over_craft("changed", "found", "closed", "N_r", "Y_v"),
        "fault": over_craft(
            "fault", "found", "filter_alone", "with_gate", "without_fault", "nominal"
        ),
        "reason": figures["fault"][0]["reason"],
    }
    return json.loads(json.dumps(told, default=float))


def draw(shown: dict[str, tuple], true: dict, document: dict) -> None:
    """Estimates of the yaw damping in the three studies, with trust below."""
    figure = Figure(figsize=(12.0, 6.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 3, sharex=True, height_ratios=(3, 1))
    titles = (
        "sound zig-zag: convergence", "drag grows by half at 100 s",
        "compass frozen from 100 to 130 s",
    )  # fmt: skip
    for column, (key, title) in enumerate(zip(shown, titles, strict=True)):
        run = shown[key][0]
        _estimates(axes[0, column], run, true["hull"]["N_r"], key == "changed")
        if key == "clean":
            least = shown[key][1]
            axes[0, 0].plot(least.t, least.estimate["N_r"], color="#3a8f5c", lw=1,
                            label="least squares")  # fmt: skip
        axes[0, column].axhline(document["hull"]["N_r"], color="#8a8a8a", ls=":", label="nominal")
        axes[0, column].set_title(title, fontsize=10)
        axes[1, column].plot(run.t, run.trust, color="#5b6770", lw=1)
        axes[1, column].fill_between(run.t, 0, 1, where=~run.open, color="#b03a48", alpha=0.15,
                                     label="gate closed", lw=0)  # fmt: skip
        axes[1, column].axhline(0.5, color="#8a8a8a", ls=":")
        axes[1, column].set(ylim=(0, 1.05), xlabel="time, s")
    axes[0, 0].set_ylabel("N_r, N m s/rad")
    axes[1, 0].set_ylabel("trust")
    axes[0, 0].legend(frameon=False, fontsize=8)
    axes[1, 2].legend(frameon=False, fontsize=8, loc="lower right")
    out = Path("out") / "online_estimation"
    out.mkdir(parents=True, exist_ok=True)
    figure.savefig(out / "online.png", dpi=110)


def _estimates(ax: matplotlib.axes.Axes, run: OnlineRun, true: float, changed: bool) -> None:
    value, std = run.estimate["N_r"], run.std["N_r"]
    ax.fill_between(run.t, value - 2 * std, value + 2 * std, color="#1f5fa8", alpha=0.15, lw=0)
    ax.plot(run.t, value, color="#1f5fa8", lw=1, label="filter, 2 std")
    ax.plot(run.t, run.handed["N_r"], color="#d1720f", lw=1.5, label="handed to the controller")
    truth = np.where((run.t >= 100) & changed, 1.5 * true, true)
    ax.plot(run.t, truth, color="black", lw=1, ls="--", label="truth")
    ax.set_ylim(2.2 * true, 0)


if __name__ == "__main__":
    main()
