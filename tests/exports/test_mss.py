"""MATLAB functions of vessels, run by GNU Octave where it is installed, against diffsea."""

import re
import shutil
import subprocess
import tomllib

import jax.numpy as jnp
import numpy as np
import pytest
from tests.boats import BOAT, CROSS_FLOW
from tests.exports import models
from tests.exports.test_planar_model import vessels

from diffsea.cli import main
from diffsea.errors import UserError
from diffsea.exports.equations import equations_of
from diffsea.exports.mss import ARRIVAL, function_name, mss_function, mss_losses
from diffsea.vessel.files import build, read_vessel, shipped_vessels
from diffsea.vessel.servo import OrderHistory


OCTAVE = shutil.which("octave-cli") or shutil.which("octave")
needs_octave = pytest.mark.skipif(OCTAVE is None, reason="GNU Octave is not installed")
ROUNDS = 5


def octave(folder, text):
    """What Octave prints of a script that sees the functions in a folder, as rows of numbers."""
    assert OCTAVE is not None
    (folder / "script.m").write_text(text, encoding="utf-8")
    words = [OCTAVE, "--no-gui", "--norc", "--quiet", "script.m"]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return [np.array(line.split(), float) for line in done.stdout.splitlines()]


def column(values):
    return "[" + " ".join(repr(float(value)) for value in values) + "]'"


def write_function(vessel, folder):
    """The vessel's function in a folder; its name, and the channels that are states."""
    equations = equations_of(vessel)
    name = function_name(equations)
    (folder / f"{name}.m").write_text(mss_function(equations), encoding="utf-8")
    return name, [c.name for c in equations.channels if c.time_constant or c.slowness]


def cases(vessel, lagging, seed):
    """Random states, executed values, orders and currents."""
    rng = np.random.default_rng(seed)
    for _ in range(ROUNDS):
        orders, executed = models.random_orders(vessel, rng), models.random_orders(vessel, rng)
        for channel in set(executed) - set(lagging):
            executed[channel] = float(vessel.servos[channel].target(orders[channel]))
        speed, direction = rng.uniform(0, 0.5), rng.uniform(-3, 3)
        yield models.random_state(vessel, rng), executed, orders, speed, direction


@pytest.fixture(scope="module")
def derivatives(tmp_path_factory):
    """Octave's xdot and U of all cases, by vessel."""
    folder = tmp_path_factory.mktemp("mss")
    lines, owners = [], []
    for name, vessel in vessels().items():
        function, lagging = write_function(vessel, folder)
        for state, executed, orders, speed, direction in cases(vessel, lagging, len(name)):
            x, y, psi, u, v, r = state
            full = column([u, v, r, x, y, psi, *(executed[c] for c in lagging)])
            lines.append(
                f"[d, U] = {function}({full}, {column(orders.values())}, {speed!r}, {direction!r});"
                ' printf("%.17g ", d, U); printf("\\n");'
            )
            owners.append(name)
    rows = octave(folder, "\n".join(lines))
    return {name: [row for row, own in zip(rows, owners, strict=True) if own == name]
            for name in owners}  # fmt: skip


@needs_octave
@pytest.mark.parametrize("name", [*shipped_vessels(), "odd"])
def test_octave_finds_the_accelerations_of_diffsea(name, derivatives, tmp_path):
    vessel = vessels()[name]
    _, lagging = write_function(vessel, tmp_path)
    rows = derivatives[name]
    assert len(rows) == ROUNDS
    for row, case in zip(rows, cases(vessel, lagging, len(name)), strict=True):
        state, executed, _, speed, direction = case
        current = (speed * np.cos(direction), speed * np.sin(direction))
        expected = models.rate(vessel, state, executed, current)
        found = row[[3, 4, 5, 0, 1, 2]]
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-11 * abs(expected).max())
        assert row[-1] == pytest.approx(np.hypot(*state[3:5]), rel=1e-12)


@needs_octave
@pytest.mark.parametrize("name", [*shipped_vessels(), "odd"])
def test_octave_finds_how_fast_actuators_move(name, derivatives, tmp_path):
    vessel = vessels()[name]
    _, lagging = write_function(vessel, tmp_path)
    for row, case in zip(derivatives[name], cases(vessel, lagging, len(name)), strict=True):
        _, executed, orders, _, _ = case
        for place, channel in enumerate(lagging):
            servo = vessel.servos[channel]
            held = OrderHistory(jnp.array([-9e9, -8e9]), jnp.full(2, orders[channel]))
            short = 1e-6
            after = float(servo.respond(jnp.asarray(executed[channel]), held, 0.0, short).final)
            rate = (after - executed[channel]) / short
            assert row[6 + place] == pytest.approx(rate, rel=1e-4, abs=1e-6)


@needs_octave
def test_a_run_in_octave_is_that_of_diffsea(tmp_path):
    """A zig of kvlcc2, whose rudder slews, by Runge-Kutta steps of Octave's own."""
    vessel = read_vessel("kvlcc2").vessel
    function, lagging = write_function(vessel, tmp_path)
    assert lagging == ["rudder"]
    orders = {"propeller": 11.0, "rudder": 0.3}
    start = np.array([0.0, 0.0, 0.4, 1.1, 0.0, 0.0])
    text = f"""
x = [1.1 0 0 0 0 0.4 0]'; h = 0.05;
f = @(x) {function}(x, {column(orders.values())});
for k = 1:800
  k1 = f(x); k2 = f(x + h / 2 * k1); k3 = f(x + h / 2 * k2); k4 = f(x + h * k3);
  x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4);
end
printf("%.17g ", x); printf("\\n");
"""
    (end,) = octave(tmp_path, text)
    before = {"propeller": 11.0, "rudder": 0.0}
    expected = models.run(vessel, start, [(-1.0, before), (0.0, orders)], 40.0)[0][-1]
    late = ARRIVAL * 1.1  # what the last slewing before arrival costs, in metres
    np.testing.assert_allclose(end[[3, 4]], expected[:2], atol=late)
    np.testing.assert_allclose(end[5], expected[2], atol=0.01)
    np.testing.assert_allclose(end[:3], expected[3:], atol=1e-3)
    assert abs(expected[2] - 0.4) > 0.5


def test_delays_are_refused_by_name_and_left_out_where_allowed(capsys, tmp_path):
    words = ["export", "shioji_maru", "--to", "mss", "-o", str(tmp_path / "out")]
    assert main(words) == 1
    assert "cannot express: the delay of 'bow'; the delay of 'stern'" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    assert main([*words, "--allow-loss"]) == 0
    assert "left out: the delay of 'bow'" in capsys.readouterr().err
    text = (tmp_path / "out" / "shioji_maru_3dof.m").read_text()
    assert "% LEFT OUT: the delay of 'stern'." in text


def test_the_function_needs_no_other_file():
    """Every function that is called is MATLAB's own or in the file."""
    own = {"sqrt", "cos", "sin", "atan2", "hypot", "abs", "min", "max", "round", "zeros", "sign"}
    own |= {"length", "error", "exp"}
    for vessel in vessels().values():
        text = mss_function(equations_of(vessel))
        code = "\n".join(line.partition("%")[0] for line in text.splitlines())
        code = re.sub(r"'[^'\n]*'", "", code)
        defined = set(re.findall(r"^function (?:.*= )?(\w+)\(", code, re.MULTILINE))
        called = set(re.findall(r"\b([A-Za-z]\w*)\(", code)) - {"x", "ui", "tau", "k_T"}
        assert called <= own | defined, called - own - defined
        used = called | {function_name(equations_of(vessel))}
        assert defined <= used


def test_names_that_become_the_same_variable_are_refused():
    twin = BOAT.replace('name = "port"', 'name = "a b"').replace('"starboard"', '"a_b"')
    equations = equations_of(build(tomllib.loads(twin + CROSS_FLOW)))
    assert mss_losses(equations) == ()
    with pytest.raises(UserError, match="'a b' and 'a_b'.*same"):
        mss_function(equations)
