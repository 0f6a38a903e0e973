"""When did actuators act? The motion asked, beside what their records say.

    python -m experiments.concealed_real.shifted_orders

The facts of `facts.py` on milliAmpere are from the measured speeds of the motors. Here orders are
written late or lagged by hand, before anything is fitted, and the vessel, its gusts, its sensors'
noise and a latency of the velocities are fitted anew to each: how much less likely is the motion
than at best? KCS's recorded rudder and propeller are moved likewise, her roll coupling fitted with
the vessel. Writes `results/shifted_orders.json`, with how seldom the motors' readings change.
"""

import dataclasses
import json

from experiments.concealed_real import sets
from experiments.concealed_real.material import Material, Run
from experiments.concealed_real.results import FOLDER
from experiments.concealed_real.run import WORK

import numpy as np

import diffsea


PATH = FOLDER / "shifted_orders.json"
LATE = "sensor-latency:velocity"
DELAYS = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)  # s
LAGGED = ((0.6, 0.5), (0.6, 0.8), (0.6, 1.3))  # s of dead time and of lag, as the motors read
CHANNELS = ("a1", "a2", "a3", "a4")
ROLL = "roll-coupling"
MOVES = (-0.6, -0.4, -0.2, 0.0, 0.2, 0.4, 0.6)  # s by which KCS's records are later


def held_late(t: np.ndarray, values: np.ndarray, delay: float) -> np.ndarray:
    """Orders that hold until the next, so much later; the first one before it."""
    return values[np.maximum(np.searchsorted(t, t - delay + 1e-9, side="right") - 1, 0)]


def lagged(t: np.ndarray, values: np.ndarray, constant: float) -> np.ndarray:
    """Values behind a first-order lag (s)."""
    out = np.array(values, float)
    for k in range(1, len(out)) if constant else ():
        kept = np.exp(-(t[k] - t[k - 1]) / constant)
        out[k] = values[k] + (out[k - 1] - values[k]) * kept
    return out


def shifted(run: Run, delay: float, constant: float) -> Run:
    """The run with all orders late, and the speeds of the motors lagged besides."""
    out, t = run.copy(), run["t"].to_numpy()
    for name in CHANNELS:
        force = held_late(t, run[f"cmd_{name}.force"].to_numpy(), delay)
        speed = lagged(t, np.sign(force) * np.sqrt(np.abs(force)), constant)
        out[f"cmd_{name}.force"] = speed * np.abs(speed)
        out[f"cmd_{name}.angle"] = held_late(t, run[f"cmd_{name}.angle"].to_numpy(), delay)
    return out


def moved(run: Run, delay: float) -> Run:
    """The run with everything that was executed recorded so much later; linear between rows."""
    out, t = run.copy(), run["t"].to_numpy()
    for name in (column for column in run.columns if column.startswith("exec_")):
        out[name] = np.interp(t - delay, t, run[name].to_numpy())
    return out


def deviance(material: Material, effect: str) -> float:
    """-2 log likelihood of the training runs, priors included, at the best fit with an effect."""
    # Once diffsea has set JAX up.
    from diffsea.identification.coordinates import free_by_default
    from diffsea.identification.fit import Start, estimate, estimate_surely
    from diffsea.identification.problem import make_problem
    from diffsea.vessel.effects import EFFECTS

    path, train, _ = material.write(WORK / "shifted_orders")
    vessel = diffsea.read_vessel(path).vessel
    runs = [diffsea.read_recording(file) for file in train]
    free = free_by_default(vessel)
    problem = make_problem(vessel, runs, free, (EFFECTS[effect],))
    rough = estimate(problem, free)
    return estimate_surely(problem, (*free, effect), Start.of_other_data(rough)).deviance


def readings_that_repeat(run: Run) -> float:
    """Share of rows in which a motor's speed is read as in the row before while its order moves."""
    same = []
    for name in CHANNELS:
        read, order = (run[f"{kind}_{name}.force"].to_numpy() for kind in ("exec", "cmd"))
        same.append((np.diff(read) == 0)[np.diff(order) != 0])
    return float(np.mean(np.concatenate(same)))


def main() -> None:
    """Fit to the orders shifted in each way, and write what was found."""
    diffsea.prepare_jax()
    whole = sets.SETS["milliampere"].load()
    orders = dataclasses.replace(sets.SETS["milliampere-orders"].load(), test={})
    found = []
    for delay, constant in [(delay, 0.0) for delay in DELAYS] + list(LAGGED):
        told = orders.with_runs(lambda run, d=delay, c=constant: shifted(run, d, c))
        found.append({"delay": delay, "lag": constant, "deviance": deviance(told, LATE)})
        print(found[-1], flush=True)
    repeated = {name: round(readings_that_repeat(run), 3) for name, run in whole.train.items()}
    kcs, by_move = dataclasses.replace(sets.SETS["kcs"].load(), test={}), []
    for delay in MOVES:
        told = kcs.with_runs(lambda run, d=delay: moved(run, d))
        by_move.append({"delay": delay, "deviance": deviance(told, ROLL)})
        print("kcs", by_move[-1], flush=True)
    for several in (found, by_move):
        least = min(one["deviance"] for one in several)
        for one in several:
            one["worse"] = round(one.pop("deviance") - least, 1)
    record = {"shifts": found, "repeated": repeated, "kcs": by_move}
    PATH.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
