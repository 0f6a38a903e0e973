"""Orders in another unit than the vessel's are told, and stop what would be made of them."""

import dataclasses

import numpy as np
import pandas as pd
import pytest
from tests.paths import ORACLE

from diffsea import UserError, VesselFile, diagnose, fit, predict
from diffsea.cli import main
from diffsea.recordings import KINDS
from diffsea.simulation.order_units import (
    require_order_units,
    unit_findings,
    with_usable_actuation,
)
from diffsea.trajectory import Trajectory
from diffsea.vessel.files import build


HULL = {
    "length": 5.0, "beam": 2.0, "draught": 0.3, "mass": 200.0, "I_z": 400.0,
    "X_udot": -10.0, "Y_vdot": -120.0, "N_rdot": -200.0, "X_u": -50.0, "Y_v": -200.0, "N_r": -800.0,
}  # fmt: skip
SHARE = np.sin(0.3 * np.arange(200)) * np.linspace(0.3, 1.0, 200)  # of full order


def vessel(kind="thruster", **table):
    return build({"hull": HULL, kind: [{"name": "part", "x": -2.0, **table}]})


def run(orders, channel="part", executed=None):
    t = 0.1 * np.arange(len(orders))
    done = {} if executed is None else {channel: executed}
    return Trajectory(t, *(0 * t,) * 6, commanded={channel: orders}, executed=done, extra={},
                      valid=np.ones(t.size, bool), name="run.csv")  # fmt: skip


THRUSTERS = {
    "N": {"max_force": 250.0, "min_force": -180.0},
    "rev/s": {"unit": "rev/s", "curve": {"c": 0.0, "d": 0.5}, "max_speed": 15.0},
    "rpm": {"unit": "rpm", "curve": {"c": 0.0, "d": 0.5}, "max_speed": 900.0},
    "percent": {"unit": "percent", "max_force": 250.0},
    "normalised": {"unit": "normalised", "max_force": 250.0},
    "us": {"unit": "us", "max_force": 250.0},
}
ORDERS = {
    "N": np.where(SHARE < 0, 180, 250) * SHARE, "rev/s": 15 * SHARE, "rpm": 900 * SHARE,
    "percent": 100 * SHARE, "normalised": SHARE, "us": 1500 + 400 * SHARE,
}  # fmt: skip
LOOKS = {"rpm": "revolutions per minute", "percent": "per cent", "normalised": "normalised",
         "us": "pulse widths"}  # fmt: skip
# Too near one another: less than three times, and more than a fiftieth of, what the vessel takes.
NEAR = {("N", "rev/s"), ("N", "percent"), ("rev/s", "normalised"), ("rpm", "N"), ("rpm", "us"),
        ("rpm", "percent"), ("percent", "N"), ("percent", "rev/s")}  # fmt: skip
FAINT = {("N", "normalised"), ("rpm", "rev/s"), ("rpm", "normalised"), ("percent", "normalised")}


@pytest.mark.parametrize("given", ORDERS)
@pytest.mark.parametrize("own", THRUSTERS)
def test_orders_of_a_thruster_in_another_unit_are_found_and_named(own, given):
    boat = vessel(**THRUSTERS[own])
    found = unit_findings(boat, run(ORDERS[given]))
    if given == own:
        assert not found
        return
    if (own, given) in NEAR:
        assert all(one.doubt and "acts as the limit" in one.message for one in found)
        return
    (finding,) = found
    assert finding.kind == "actuation-unit" and finding.kind in KINDS
    assert finding.channels == ("cmd_part",) and finding.recording == "run.csv"
    assert LOOKS.get(given, "") in finding.message
    assert bool(finding.doubt) == ((own, given) in FAINT)
    if finding.doubt:
        require_order_units(boat, [run(ORDERS[given])])
        return
    with pytest.raises(UserError) as error:
        require_order_units(boat, [run(ORDERS[own]), run(ORDERS[given])])
    least, most = np.quantile(ORDERS[given], (0.01, 0.99))
    for said in ("run.csv: order part (cmd_part) is", f"{least:.4g} to {most:.4g}", own):
        assert said in str(error.value)


def test_shaft_speeds_beside_orders_in_per_cent_are_not_used():
    """Of both runs, and one remark; without orders, or with wrong ones, nothing is left to use."""
    boat, told = vessel(**THRUSTERS["percent"]), []
    orders, speeds = ORDERS["percent"], 9.6 * ORDERS["percent"]
    measured = run(orders, executed=speeds)
    used = with_usable_actuation(boat, [measured, measured], told.append)
    assert [one.executed for one in used] == [{}, {}] and used[0].commanded == measured.commanded
    (remark,) = told
    assert "exec_part in another unit than the orders (run.csv, run.csv)" in remark
    same = run(orders, executed=0.9 * orders)
    assert with_usable_actuation(boat, [same], told.append) == [same] and len(told) == 1
    for lacking in ({}, {"part": speeds}):
        with pytest.raises(UserError, match="look like"):
            with_usable_actuation(boat, [dataclasses.replace(measured, commanded=lacking)])


def test_overshoots_and_wild_values_are_no_other_unit():
    boat = vessel(**THRUSTERS["N"])
    assert all(one.doubt for one in unit_findings(boat, run(2.5 * ORDERS["N"])))
    wild = np.where(np.arange(200) == 70, 1e5, ORDERS["N"])
    assert not unit_findings(boat, run(wild))
    assert not unit_findings(boat, run(0 * SHARE))  # adrift
    missing = np.where(np.arange(200) % 3 == 0, ORDERS["us"], np.nan)
    assert unit_findings(boat, run(missing))


@pytest.mark.parametrize(("largest", "told"), [(250.0, False), (262.0, False), (400.0, True)])
def test_orders_beyond_what_the_vessel_takes_are_told_with_their_share(largest, told):
    orders = np.where(np.arange(200) % 4 == 0, largest, 100.0)
    found = unit_findings(vessel(max_force=250.0, min_force=-180.0), run(orders))
    assert len(found) == told
    if told:
        (finding,) = found
        assert finding.doubt and finding.value == pytest.approx(0.25)
        assert "-180 to 250 N: 25 % of it lies beyond" in finding.message
    require_order_units(vessel(max_force=250.0, min_force=-180.0), [run(orders)])


def test_rudders_and_azimuth_thrusters_in_degrees():
    rudder = vessel("rudder", area=0.1, max_angle=0.6)
    assert not unit_findings(rudder, run(0.7 * SHARE))
    (finding,) = unit_findings(rudder, run(35 * SHARE))
    assert "degrees" in finding.message and "-0.6 to 0.6 rad" in finding.message
    assert 'unit = "deg"' in finding.repair
    (finding,) = unit_findings(vessel("rudder", area=0.1), run(35 * SHARE))
    assert "degrees" in finding.message
    assert "us" in unit_findings(rudder, run(1500 + 300 * SHARE))[0].message
    pod = vessel("azimuth_thruster")
    wound = np.linspace(0.0, 40.0, 200)
    for angle in (wound, np.mod(wound + np.pi, 2 * np.pi) - np.pi, np.mod(wound, 2 * np.pi)):
        assert not unit_findings(pod, run(angle, "part.angle"))
    (finding,) = unit_findings(pod, run(np.mod(np.degrees(wound), 360.0), "part.angle"))
    assert finding.channels == ("cmd_part.angle",)


def test_what_was_measured_is_asked_as_well():
    (finding,) = unit_findings(vessel(**THRUSTERS["N"]), run(ORDERS["N"], executed=ORDERS["us"]))
    assert finding.channels == ("exec_part",)


@pytest.mark.parametrize("work", [predict, fit, diagnose])
def test_nothing_is_calculated_with_orders_in_another_unit(work, tmp_path, capsys):
    boat, bad = ORACLE / "usv.toml", tmp_path / "bad.csv"
    t = 0.2 * np.arange(200)
    pulses = 1500 + 300 * SHARE
    motion = {"x": t, "u": 1 + 0 * t} | dict.fromkeys(("y", "psi", "v", "r"), 0 * t)
    orders = dict.fromkeys(("cmd_port", "cmd_starboard"), pulses)
    pd.DataFrame({"t": t} | motion | orders).to_csv(bad, index=False)
    with pytest.raises(
        UserError, match=r"bad.csv: order port \(cmd_port\) is .*pulse widths in us \(likewise"
    ):
        work(boat, bad)
    status = main([work.__name__, str(boat), str(bad), "-o", str(tmp_path / "out")])
    said = capsys.readouterr().err
    assert status == 1 and "pulse widths in us" in said and "Traceback" not in said
    assert not (tmp_path / "out" / "fit.json").exists()


def test_predictions_and_fits_tell_of_orders_that_act_as_a_limit():
    boat = vessel(**THRUSTERS["N"])
    beyond = run(np.where(np.arange(200) % 4 == 0, 400.0, 100.0))
    told = "25 % of it lies beyond and acts as the limit"
    assert told in " ".join(predict(boat, beyond).predicted.provenance)
    assert told not in " ".join(predict(boat, run(ORDERS["N"])).predicted.provenance)
    measured = run(beyond.commanded["part"], executed=np.full(200, 100.0))  # no order is used
    assert told not in " ".join(predict(boat, measured).predicted.provenance)
    said: list[str] = []
    document = {"hull": HULL, "thruster": [{"name": "part", "x": -2.0, **THRUSTERS["N"]}]}
    file = VesselFile(boat, document, "boat.toml")
    fit(file, [beyond], free=["X_u"], profiles=(), progress=said.append)
    assert [line for line in said if told in line and line.startswith("run.csv: ")]
