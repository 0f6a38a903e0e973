"""What the paper's model lacks, as the diagnosis names it from a few noisy runs of the plant."""

import time
from collections.abc import Callable, Mapping

from experiments.vrx_wamv.campaign import Run
from experiments.vrx_wamv.joint import QUADRATIC
from experiments.vrx_wamv.models import document, truth
from experiments.vrx_wamv.plant import NEW, Plant

from diffsea.diagnosis.record import summary
from diffsea.diagnosis.verdict import diagnose
from diffsea.vessel.files import build


DRAG = ("X_u", "Y_v", "N_r")


def linear_document(drag: Mapping[str, float], plant: Plant = NEW) -> dict:
    """The paper's model: linear drag only. Mass properties and thrust are the description's."""
    body = {key: truth(plant)[key] for key in ("mass", "x_G", "I_z")}
    table = document(body | {key: drag[key] for key in DRAG}, "linear")
    table["hull"] = {k: v for k, v in table["hull"].items() if k not in QUADRATIC}
    return table


def diagnosed(
    runs: list[Run], drag: Mapping[str, float], say: Callable[[str], None], plant: Plant = NEW
) -> dict:
    """The diagnosis of the linear model on some runs, in short."""
    began = time.perf_counter()
    vessel = build(linear_document(drag, plant))
    found = diagnose(vessel, [run.trajectory() for run in runs], progress=_now_and_then(say))
    record = summary(found, [])
    true = truth(plant)
    effects = [
        {"name": effect["name"], "alternatives": effect["alternatives"], "parameter": name,
         "value": entry["value"], "std": entry["std"], "unit": entry["unit"], "truth": true[name]}
        for effect in record["effects"] for name, entry in effect["parameters"].items()
    ]  # fmt: skip
    rejected = [c for c in record["candidates"] if c["status"] != "accepted"]
    return {
        "verdict": record["verdict"], "effects": effects, "fit": record["fit"],
        "runs": [run.name for run in runs],
        "rejected": {c["name"]: c["log10_odds"] for c in rejected[:5]},
        "seconds": time.perf_counter() - began,
    }  # fmt: skip


def _now_and_then(say: Callable[[str], None]) -> Callable[[str], None]:
    return lambda message: say(f"diagnosis: {message}") if "round" not in message else None
