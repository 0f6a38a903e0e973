"""Azimuth thrusters among the columns of foreign tables, by their names."""

import numpy as np
import pandas as pd
import pytest
from tests.oracle.make_recordings import load, produce
from tests.paths import ORACLE

from diffsea import propose_mapping
from diffsea.recordings.mapping_proposal import SURE, suggest_labels
from diffsea.recordings.mapping_proposal.azimuths import azimuth_columns


def found(*names: str) -> list[tuple[str, str, str]]:
    """Name, power and angle of what is found among columns."""
    suggestions = {name: suggest_labels(name) for name in names}
    return [one[:3] for one in azimuth_columns(names, suggestions)]


@pytest.mark.parametrize("power, angle, name", [
    ("bow_rpm_order", "bow_angle_order_deg", "bow"),
    ("cmdAftThrust [N]", "cmdAftAngle [rad]", "aft"),
    ("a1_n", "a1_alpha", "a1"),
    ("thruster 2 rpm", "thruster 2 azimuth", "thruster2"),
    ("rpm", "azimuth_deg", "azimuth"),
    ("1_rpm", "1_angle", "azimuth1"),
    ("propeller_rpm", "propeller_azimuth", "propeller"),
])  # fmt: skip
def test_what_is_named_alike_but_for_power_and_angle_is_one_thruster(power, angle, name):
    assert found("t", power, "psi", angle, "yaw_rate") == [(name, power, angle)]


@pytest.mark.parametrize("names", [
    ("rudder_angle", "rudder_force"),
    ("propeller_angle", "propeller_rpm"),  # of its blades
    ("wind_angle", "wind_force"),
    ("bow_rpm", "stern_angle"),
    ("bow_rpm_order", "bow_angle_actual"),
    ("engine_rpm", "crank_angle"),
    ("bow_rpm", "heading_angle"),
])  # fmt: skip
def test_nothing_else_with_an_angle_is_an_azimuth_thruster(names):
    assert found(*names) == []


@pytest.mark.parametrize("names, realised", [
    (("motor_rpm_cmd", "motor_angle_cmd", "motor_rpm"), {"force": "motor_rpm"}),
    (("motor_rpm_cmd", "motor_angle_cmd", "motor_angle_actual"), {"angle": "motor_angle_actual"}),
    (("motor_rpm_cmd", "motor_angle_cmd", "bow_rpm"), {}),
    (("motor_rpm_cmd", "motor_angle_cmd", "motor_rpm_actual", "motor_angle_actual"), {}),
    (("motor_rpm_actual", "motor_angle_actual", "motor_rpm"), {}),
])  # fmt: skip
def test_what_was_measured_of_one_order_alone_belongs_to_it(names, realised):
    first, *_ = azimuth_columns(names, {name: suggest_labels(name) for name in names})
    assert first.realised == realised
    assert first.columns == (*names[:2], *realised.values())


@pytest.mark.parametrize("span", [1, 6], ids=["at-once", "lagging"])
def test_their_columns_are_orders_that_the_mapping_keeps_apart(span, tmp_path):
    produce(tmp_path, load(ORACLE / "boat.toml"), 5, seconds=60.0, rate=4.0, runs=["random-fast"])
    motion = pd.read_csv(tmp_path / "random-fast.csv")[["t", "x", "y", "psi", "u", "v", "r"]]
    levels = np.random.default_rng(0).uniform(-1, 1, (len(motion) // 8 + 1, 2))
    steps = np.repeat(levels, 8, axis=0)[: len(motion)]
    foreign = motion.assign(fore_rpm_order=1500 * steps[:, 0], fore_angle_order=120 * steps[:, 1])
    foreign["fore_rpm"] = foreign["fore_rpm_order"].ewm(span=span).mean()
    foreign.to_csv(tmp_path / "foreign.csv", index=False)
    proposal = propose_mapping(tmp_path / "foreign.csv")
    columns = proposal.mapping.channels
    assert columns["cmd_fore.force"].column == "fore_rpm_order"
    assert columns["cmd_fore.force"].unit is None, "as the vessel file says"
    assert columns["cmd_fore.angle"].unit == "deg"
    assert columns["exec_fore.force"].column == "fore_rpm"
    assert proposal.sure["exec_fore.force"] > 0.8
    assert not {"cmd_rudder", "cmd_propeller"} & set(columns)
    assert max(proposal.sure["cmd_fore.force"], proposal.sure["cmd_fore.angle"]) < SURE
