"""Idle stretches: rest, disarmed, carried and upside down are found, and nothing else."""

import dataclasses

import numpy as np
from tests.recordings.driven_boat import drive, noisy

from diffsea.recordings.idle import idle_stretches, used_spans, without_idle
from diffsea.trajectory import Trajectory


def run_of(boat, armed=False, roll=False):
    slow = boat.every(0.1)
    extra = {"armed": slow.armed} if armed else {}
    extra |= {"phi": slow.roll} if roll else {}
    motion = {name: getattr(slow, name) for name in ("x", "y", "psi", "u", "v", "r")}
    return Trajectory(
        t=slow.t,
        **motion,
        commanded={"port": slow.port, "starboard": slow.starboard},
        executed={},
        extra=extra,
        valid=np.ones(slow.t.shape, bool),
    )


def test_rest_before_and_after_is_idle_but_for_five_seconds():
    run = run_of(noisy(drive(dock=40.0, after=40.0)))
    before, after = idle_stretches(run)
    assert before.why == after.why == "at rest without orders"
    assert before.start == 0 and abs(before.end - 34) < 1.5
    assert abs(after.start - 408) < 4 and after.end == run.t[-1]
    ((start, end),) = used_spans(run, [before, after])
    assert (start, end) == (before.end, after.start)


def test_disarmed_and_upside_down_are_named_and_come_first():
    run = run_of(noisy(drive(upside_down=30.0)), armed=True, roll=True)
    found = {one.why: one for one in idle_stretches(run)}
    assert abs(found["disarmed"].end - 25) < 0.2
    assert abs(found["upside down"].start - 440) < 0.2 and found["upside down"].end == run.t[-1]


def test_a_boat_that_is_driven_home_by_car_is_carried():
    boat = noisy(drive(after=120.0))
    fast = np.where((boat.t > 440) & (boat.t < 500), 12.0, 0.0)
    run = run_of(dataclasses.replace(boat, u=boat.u + fast))
    carried = [one for one in idle_stretches(run) if one.why.startswith("carried")]
    assert len(carried) == 1 and abs(carried[0].start - 440) < 4 and abs(carried[0].end - 500) < 4


def test_a_run_that_never_rests_and_holding_station_are_used_whole():
    run = run_of(noisy(drive(dock=0.0, after=0.0)))
    assert idle_stretches(run) == [] and without_idle(run)[0] == [run]
    boat = noisy(drive(dock=0.0, after=0.0))
    rng = np.random.default_rng(2)
    still = np.zeros_like(boat.t)
    busy = np.repeat(1500.0 + rng.integers(-80, 80, boat.t.size // 50 + 1), 50)[: boat.t.size]
    held = dataclasses.replace(boat, x=still, y=still, u=still, v=still, r=still, port=busy)
    assert idle_stretches(run_of(held)) == []


def test_the_parts_that_are_used_keep_their_times_and_say_so():
    run = run_of(noisy(drive(dock=60.0, after=60.0)))
    (piece,), idle = without_idle(run)
    assert len(idle) == 2 and piece.t[0] >= idle[0].end and piece.t[-1] <= idle[1].start
    assert piece.name == f"run [{idle[0].end:.0f} s to {idle[1].start:.0f} s]"
    assert any(note.startswith("cut to t =") for note in piece.provenance)
