"""Functional mock-up units, built by PythonFMU3 and run by FMPy without diffsea and JAX."""

import json
import subprocess
import sys
from importlib.util import find_spec

import numpy as np
import pytest
from tests.exports import models

from diffsea.cli import main
from diffsea.vessel.files import read_vessel


needs_fmi = pytest.mark.skipif(
    find_spec("pythonfmu3") is None or find_spec("fmpy") is None,
    reason="PythonFMU3 and FMPy are not installed",
)
# Run by another Python in which diffsea and JAX cannot be imported.
SCRIPT = """
import json, sys

class Barrier:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("diffsea", "jax", "jaxlib", "equinox"):
            raise ImportError(f"{name} is not here")

sys.meta_path.insert(0, Barrier())
import numpy as np
from fmpy import read_model_description, simulate_fmu
from fmpy.validation import validate_fmu

unit, inputs, starts, stop = json.loads(sys.stdin.read())
about = read_model_description(unit)
names = [name for name in inputs[0] if name != "time"]
rows = np.array([tuple(row[n] for n in ["time", *names]) for row in inputs],
                dtype=[(n, float) for n in ["time", *names]])
found = simulate_fmu(unit, stop_time=stop, step_size=0.1, output_interval=0.5, input=rows,
                     start_values=starts)
print(json.dumps({
    "columns": list(found.dtype.names), "rows": [list(map(float, row)) for row in found],
    "problems": validate_fmu(unit), "version": about.fmiVersion,
    "variables": {v.name: v.causality for v in about.modelVariables},
    "loaded": sorted({m.split(".")[0] for m in sys.modules}),
}))
"""


@pytest.fixture
def ran(tmp_path, capsys):
    """Export a vessel and run it by FMPy: inputs as rows, start values, seconds."""

    def run(vessel, inputs, starts, stop):
        words = ["export", vessel, "--to", "fmu", "-o", str(tmp_path / "out"), "--json"]
        assert main(words) == 0
        unit = json.loads(capsys.readouterr().out)["file"]
        given = json.dumps([unit, inputs, starts, stop])
        done = subprocess.run(
            [sys.executable, "-c", SCRIPT], input=given, capture_output=True, text=True,
            cwd=tmp_path, timeout=300,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout.splitlines()[-1])

    return run


@needs_fmi
@pytest.mark.parametrize("name", ["blueboat", "shioji_maru", "pytheas"])
def test_a_unit_runs_as_diffsea_does_without_diffsea_and_jax(name, ran):
    vessel, rng = read_vessel(name).vessel, np.random.default_rng(11)
    current = (0.1, -0.2)
    times = (0.0, 8.0, 21.0)
    plan = [(t, models.random_orders(vessel, rng, 0.5)) for t in times]
    ends = [*times[1:], 40.0]
    inputs = []
    for (since, orders), until in zip(plan, ends, strict=True):
        row = {f"cmd_{channel}": value for channel, value in orders.items()}
        row |= {"current_north": current[0], "current_east": current[1]}
        inputs += [{"time": since} | row, {"time": until} | row]
    start = models.random_state(vessel, rng)
    starts = {f"{n}_start": float(x) for n, x in zip(models.STATES, start, strict=True)}
    starts |= {key: value for key, value in inputs[0].items() if key != "time"}

    found = ran(name, inputs, starts, 40.0)

    assert found["problems"] == [] and found["version"] == "3.0"
    assert not {"diffsea", "jax"} & set(found["loaded"])
    expected, executed = models.run(vessel, start, plan, 40.0, current, step=0.05)
    rows = np.array(found["rows"])[:, [found["columns"].index(n) for n in models.STATES]]
    error = np.abs(rows - expected[::10])
    speed = np.abs(expected[:, 3:5]).max()
    assert error[:, :2].max() < 1e-4 * 40.0 * speed
    assert error[:, 3:5].max() < 1e-4 * speed
    for channel, value in executed[-1].items():
        assert found["rows"][-1][found["columns"].index(f"exec_{channel}")] == pytest.approx(
            float(value), rel=1e-9, abs=1e-9
        )


@needs_fmi
def test_inputs_are_orders_and_a_current_and_outputs_are_motion_and_execution(ran):
    found = ran("otter", [{"time": 0.0, "cmd_port": 5.0}, {"time": 1.0, "cmd_port": 5.0}], {}, 1.0)
    of = lambda kind: {name for name, causality in found["variables"].items() if causality == kind}
    assert of("input") == {"cmd_port", "cmd_starboard", "current_north", "current_east"}
    assert of("output") == {*models.STATES, "exec_port", "exec_starboard"}
    assert of("parameter") == {f"{name}_start" for name in models.STATES}


def test_without_pythonfmu3_the_message_says_what_to_install(monkeypatch, tmp_path, capsys):
    monkeypatch.setitem(sys.modules, "pythonfmu3", None)
    assert main(["export", "otter", "--to", "fmu", "-o", str(tmp_path / "out")]) == 1
    assert "pip install 'diffsea[fmu]'" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
