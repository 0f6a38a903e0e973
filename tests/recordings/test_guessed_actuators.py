"""Actuators of logs whose topics have names of their own, and of tables with native motion."""

import numpy as np
import pandas as pd
import pytest
from tests.recordings.test_logs import Messages, bag  # noqa: F401  a fixture

from diffsea.cli import main
from diffsea.recordings import read_mapping
from diffsea.workflows.checks import ChosenMapping, check_logs, choose_mappings


DT, SECONDS = 0.1, 200.0


def launch(seed: int) -> pd.DataFrame:
    """A body with a thruster aft that turns by half a right angle, and yaw that answers it."""
    rng = np.random.default_rng(seed)
    rows = int(SECONDS / DT)
    hold = lambda least, most: np.repeat(rng.uniform(least, most, rows // 60 + 1), 60)[:rows]
    power, angle = hold(800.0, 3000.0), np.radians(hold(-40.0, 40.0))
    r, u = np.zeros(rows), np.zeros(rows)
    for k in range(rows - 1):
        r[k + 1] = r[k] + DT * (-r[k] - 2e-4 * power[k] * np.sin(angle[k]))
        u[k + 1] = u[k] + DT * (-0.4 * u[k] + 3e-4 * power[k] * np.cos(angle[k]))
    psi = np.cumsum(r) * DT
    x, y = np.cumsum(u * np.cos(psi)) * DT, np.cumsum(u * np.sin(psi)) * DT
    noisy = lambda values, size: values + size * rng.standard_normal(rows)
    table = {"t": DT * np.arange(rows), "x": noisy(x, 0.02), "y": noisy(y, 0.02)}
    table |= {"psi": noisy(psi, 2e-3), "u": noisy(u, 0.02), "v": noisy(0 * u, 0.02)}
    return pd.DataFrame(table | {"r": noisy(r, 2e-3), "power": power, "angle": np.degrees(angle)})


def messages(
    run: pd.DataFrame, sense: float = 1.0, power="/outboard/rpm_cmd", angle="/outboard/angle_cmd"
):
    """The run as messages of ROS, in axes of REP 103; angles times `sense`."""
    make, rows = Messages("mcap"), []
    for one in run.itertuples():
        place = one.y, one.x, np.pi / 2 - one.psi
        rows.append(("/odom", one.t + 0.01, make.odometry(one.t, *place, one.u, -one.v, -one.r)))
        rows.append((power, one.t, make.number(one.power)))
        rows.append((angle, one.t, make.number(sense * one.angle)))
    return sorted(rows, key=lambda row: row[1])


def chosen(path) -> ChosenMapping:
    how = choose_mappings([path])[path]
    assert isinstance(how, ChosenMapping)
    return how


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_a_thruster_by_topics_of_any_name_is_found_with_the_sense_of_its_angle(bag, sense):  # noqa: F811
    path = bag(messages(launch(1), sense))
    how = chosen(path)
    assert how.mapping is not None and how.known is not None
    columns = how.mapping.channels
    assert columns["cmd_outboard.force"].column == "/outboard/rpm_cmd:data"
    angle = columns["cmd_outboard.angle"]
    assert (angle.column, angle.unit, angle.sign) == ("/outboard/angle_cmd:data", "deg", sense)
    assert "orders" not in how.known.missing and "likely: cmd_outboard.angle" in how.known.text
    (checked,) = check_logs([path], {path: how})
    assert "azimuth thruster" in checked.craft
    assert not any("no order" in one for one in checked.missing)


def test_a_topic_that_never_says_a_number_is_no_actuator(bag):  # noqa: F811
    run = launch(1)
    how = chosen(bag(messages(run.assign(angle=np.nan))))
    assert how.mapping is not None
    assert [name for name in how.mapping.channels if name.startswith("cmd_")] == ["cmd_propeller"]


def test_the_command_that_follows_reads_what_was_guessed(bag, tmp_path, capsys):  # noqa: F811
    path, out = bag(messages(launch(1))), tmp_path / "out"
    assert main(["check", str(path), "-o", str(out)]) == 0
    (line,) = (text for text in capsys.readouterr().out.splitlines() if "diffsea diagnose" in text)
    assert line.endswith(f"--mapping {out / 'run.mapping.toml'}")
    assert "cmd_outboard.angle" in read_mapping(out / "run.mapping.toml").channels


def test_topics_that_are_called_like_nothing_stay_unknown(bag):  # noqa: F811
    how = chosen(bag(messages(launch(1), power="/things/one", angle="/things/two")))
    assert how.known is not None and not how.known.guessed and "orders" in how.known.missing


def test_a_table_with_native_motion_and_foreign_orders_is_mapped(tmp_path):
    run = launch(2)
    foreign = run.rename(columns={"power": "pod_order", "angle": "pod_angle"})
    foreign.to_csv(tmp_path / "foreign.csv", index=False)
    native = {"pod_order": "cmd_pod.force", "pod_angle": "cmd_pod.angle"}
    foreign.rename(columns=native).assign(thrust_left=run.power, thrust_right=run.power).to_csv(
        tmp_path / "native.csv", index=False
    )
    run.rename(columns={"power": "battery", "angle": "room"}).to_csv(
        tmp_path / "idle.csv", index=False
    )
    how = chosen(tmp_path / "foreign.csv")
    assert how.mapping is not None and how.text is not None
    assert {"t", "x", "y", "psi", "u", "v", "r"} < set(how.mapping.channels)
    assert how.mapping.channels["cmd_pod.force"].column == "pod_order"
    assert how.mapping.channels["cmd_pod.angle"].unit == "deg"
    (tmp_path / "mapping.toml").write_text(how.text)
    assert read_mapping(tmp_path / "mapping.toml").channels == how.mapping.channels
    assert chosen(tmp_path / "native.csv").mapping is None
    assert chosen(tmp_path / "idle.csv").mapping is None
