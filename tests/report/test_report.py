# pyright: reportArgumentType=false
"""Reports: every section for every verdict, nothing unescaped, the summary's own numbers."""

import dataclasses
import functools
import html.parser
import itertools
import json
import math
import re
from typing import Any, NamedTuple

import numpy as np
import pytest
from tests.paths import ORACLE

from diffsea import EFFECTS, Study, Trajectory, Vessel, read_vessel, replay
from diffsea.identification.estimates import Estimate
from diffsea.identification.holdout import HeldOut, Split
from diffsea.identification.multistart import Agreement
from diffsea.identification.objectives.innovation import Innovations
from diffsea.identification.problem import Problem, make_problem
from diffsea.identification.run_models import RunModel, held_out_models
from diffsea.identification.sufficiency import FitVerdict
from diffsea.identification.uncertainty.identifiability import Identifiability, identifiability
from diffsea.identification.uncertainty.sources import Source, Sources
from diffsea.report.diagnosis import (
    candidate_ranking,
    diagnosis_report,
    interval_of,
    unseen_table,
)
from diffsea.report.fit import fit_report, worse_warning
from diffsea.report.histories import on_one_turn
from diffsea.report.page import TEMPLATES, Plot, Verbatim, with_commands
from diffsea.report.plots import figure
from diffsea.report.predictions import (
    ComparedRun,
    Prediction,
    compare,
    horizon_table,
    predict,
    worst_predicted,
)
from diffsea.report.quantities import (
    duration,
    interval,
    odds,
    probability,
    round_to_error,
    significant,
    typeset,
    with_error,
)
from diffsea.report.wording import words
from diffsea.report.wording.horizons import horizon_line
from diffsea.report.wording.terminal import verdict_text
from diffsea.report.wording.verdicts import (
    single_step_sentence,
    unimproved_sentence,
    verdict_sentence,
)
from diffsea.report.wording.words import phrase
from diffsea.vessel.files import build


USV = ORACLE / "usv.toml"
NASTY = 'zig<zag> & "20".csv'
SECTIONS = (
    "verdict", "held-out", "where", "what", "next", "unseen", "parameters", "data", "provenance",
)  # fmt: skip
VERDICTS = ("consistent", "explained", "ambiguous", "unexplained", "insufficient")


def usv(current: float = 0.0) -> Vessel:
    document = read_vessel(USV).document
    flow = {"name": "current", "speed": current, "direction": 1.2}
    return build(document | ({"effect": [flow]} if current else {}))


def recording(name: str, vessel: Vessel, phase: float = 0.0) -> Trajectory:
    """A run of the vessel in slow turns, with a little noise."""
    t = np.arange(0.0, 70.0, 0.5)
    still = {c: np.zeros_like(t) for c in ("x", "y", "psi", "v", "r")}
    turn = 60 * np.sign(np.sin(0.2 * t + phase))
    run = Trajectory(
        t=t, **still, u=np.full_like(t, 1.2), extra={}, executed={}, valid=np.ones(t.shape, bool),
        commanded={"port": 100 + turn, "starboard": 100 - turn}, name=name,
        provenance=("read from <b>file</b>, sha256 12ab", "3 rows dropped"),
    )  # fmt: skip
    shown = replay(vessel, run)
    rng = np.random.default_rng(len(name))
    size = {"x": 0.1, "y": 0.1, "psi": 0.01, "u": 0.02, "v": 0.02, "r": 0.005}
    noisy = {c: getattr(shown, c) + s * rng.normal(size=t.size) for c, s in size.items()}
    return dataclasses.replace(run, **noisy)


def maps(strength: float) -> dict:
    """Cells whose z-scores grow with the degree of freedom; some could not be tested."""
    time, regime = [], []
    for number, degree in enumerate(("surge", "sway", "yaw")):
        unit = "N m" if degree == "yaw" else "N"
        for run, k in itertools.product((NASTY, "random"), range(8)):
            z = strength * number * (-1.0) ** k if k else None
            force = None if z is None else 2.0 * z
            time.append(
                {"recording": run, "degree_of_freedom": degree, "start": 8.7 * k,
                 "end": 8.7 * (k + 1), "force": force, "std": 2.0, "z": z, "unit": unit}
            )  # fmt: skip
        for k, name in enumerate(("drift angle 0 to 8 deg", "drift angle 8 to 21.5 deg")):
            z = 2 * strength * number * k
            regime.append({"regime": name, "degree_of_freedom": degree, "force": 1.5 * z,
                           "std": 1.5, "z": z, "unit": unit})  # fmt: skip
    return {"time": time, "regime": regime, "threshold": 3.4}


CURRENT = {
    "name": "current",
    "parameters": {
        "speed": {"value": 0.3012, "std": 0.0042, "unit": "m/s", "interval": [0.2951, 0.3073]},
        "direction": {"value": 1.2043, "std": 0.0141, "unit": "rad"},
    },
    "evidence": {
        "score": 812.4, "p_value": 1.3e-9, "cost_drop": 0.62, "held_out_gain": 1540.0,
        "constancy": {"p_value": 0.4, "share": 0.01, "holds": True, "scatter": 1.0},
        "held_out_gain_std": 130.0, "log10_odds": 142.3, "log10_odds_next": 3.25,
    },
    "alternatives": [],
}  # fmt: skip


def summary_of(verdict: str) -> dict:
    found = verdict in ("explained", "ambiguous")
    effects = [CURRENT | {"alternatives": ["wind"] if verdict == "ambiguous" else []}]
    unexplained = {
        "name": "unexplained", "parameters": {}, "alternatives": [],
        "evidence": {"score": 0.0, "p_value": 1e-7, "cost_drop": 0.0},
    }  # fmt: skip
    where = [
        {
            "degree_of_freedom": "sway", "recording": NASTY, "start": 31.0, "end": 58.5,
            "regime": "drift angle 8 to 21.5 deg", "force_rms": 12.13, "unit": "N",
            "p_value": 1.2e-6,
        },
        {
            "degree_of_freedom": "yaw", "recording": "all", "start": 0.0, "end": 69.5,
            "regime": "drift angle 8 to 21.5 deg", "force_rms": 31.9, "unit": "N m",
            "p_value": 4e-5,
        },
    ]  # fmt: skip
    audit = [
        {
            "kind": "sensor-latency", "recording": NASTY, "value": 0.8, "std": 0.05, "unit": "s",
            "message": "position lags velocity by 0.80 s <script>", "repair": "offset = -0.8",
        },
        {"kind": "axes", "recording": NASTY, "value": None, "std": None, "unit": "",
         "message": "v is positive to port"},
    ]  # fmt: skip
    wind = {"speed": {"value": 3.1, "std": 0.4, "unit": "m/s"}}
    candidates = [
        {"name": "sensor-latency", "channels": ["r"], "log10_odds": -1.2, "p_value": 0.031,
         "held_out_gain": None, "held_out_gain_std": None, "parameters": {},
         "status": "screened out", "reason": "its score is <within> chance"},
        {"name": "current", "log10_odds": 142.3, "p_value": 1.3e-9, "held_out_gain": 1540.0,
         "held_out_gain_std": 130.0, "parameters": CURRENT["parameters"], "status": "accepted",
         "reason": "confirmed on held-out runs"},
        {"name": "added-mass-coupling", "variant": "Y_rdot", "log10_odds": -0.7, "p_value": 0.4,
         "status": "screened out", "reason": "its score is within chance"},
        {"name": "wind", "log10_odds": 139.1, "p_value": 2e-6, "held_out_gain": 1520.0,
         "held_out_gain_std": 130.0, "parameters": wind,
         "status": "rival" if verdict == "ambiguous" else "rejected", "reason": "weaker"},
    ]  # fmt: skip
    limits = [
        {"name": "gyro-bias", "parameter": "bias", "limit": 0.0012, "unit": "rad/s"},
        {"name": "mass-change", "parameter": "mass", "limit": None, "unit": "kg",
         "note": "no run accelerates"},
    ]  # fmt: skip
    return {
        "format": 1,
        "verdict": verdict,
        "complete": True,
        "left_out": [],
        "one_sample_in": {},
        "straight_runs": 0,
        "sides": [],
        "residual_force": {},
        "insufficient": ["parameters", "motion"] if verdict == "insufficient" else [],
        "audit": audit if verdict != "consistent" else [],
        "where": where if verdict != "consistent" else [],
        "effects": effects if found else [unexplained] if verdict == "unexplained" else [],
        "fit": {
            "nominal": {"train": 8.13, "test": 9.02},
            "diagnosed": {"train": 1.02, "test": 1.13},
        },
        "parameters": [
            parameter("X_u", "linear damping in surge", -52.0, -63.91, 1.42, 0.98),
            parameter("N_rdot", "added moment of inertia in yaw", -240.0, -231.0, 80.0, 0.3),
        ],
        "held_out": {
            "kind": "recordings", "how": "whole recordings", "recordings": ["circle"],
            "horizons": [],
        },
        "candidates": candidates,
        "detection_limits": limits,
        "map": maps(0.0 if verdict == "consistent" else 2.0),
        "map_after": maps(2.0 if verdict == "unexplained" else 0.0),
        "null": {"draws": 199, "alpha": 0.01, "threshold": 3.4},
        "remainder_p_value": 1e-7 if verdict == "unexplained" else 0.4,
        "next_experiment": {
            "manoeuvre": "turning-circle", "why": "separates current from wind",
            "seconds": 143.0, "evidence": {"turning-circle": 41.0, "zigzag": 2.2},
        }
        if verdict == "ambiguous" else None,
    }  # fmt: skip


def parameter(
    name: str, meaning: str, start: float, value: float, std: float, share: float
) -> dict:
    """A row of a table of fitted parameters."""
    return {
        "name": name, "meaning": meaning, "unit": "kg m^2", "start": start, "value": value,
        "std": std, "interval": [value - 1.645 * std, value + 1.645 * std], "determined": share,
    }  # fmt: skip


def study() -> Study:
    """A fit as if made: all at the start, N_rdot known by the vessel file alone."""
    objective = Innovations(make_problem(usv(0.3), list(recordings()[0]), ("X_u", "N_rdot")))
    fitted = estimate_of(objective.problem, {})
    information = np.diag([1e4, 0.1])
    fitted = dataclasses.replace(
        fitted, covariance=np.diag([1e-4, 0.24]), information=information,
        shrinkage=np.array([0.99, 0.04]), path=(50.0, 2.0, 1.0),
    )  # fmt: skip
    told = identifiability(objective.parameters, fitted)
    agreement = Agreement(8, 7, 3.5)
    return Study(
        "usv", objective, fitted, "anchored by <mass>", told, agreement, {}, None, {"x": 2}
    )


def estimate_of(problem: Problem, values: dict[str, tuple[float, ...]]) -> Estimate:
    """An estimate as if fitted, with these effects in SI units."""
    coordinates, noise = problem.start()
    for name, physical in values.items():
        sizes = np.array(problem.layout.sizes[[e.name for e in problem.layout.effects].index(name)])
        copies = np.array(physical).reshape(-1, len(sizes)) / sizes
        coordinates[problem.layout.slices[name]] = copies.ravel()
    index = np.arange(len(coordinates))
    free = tuple(p.name for p in problem.layout.parameters) + tuple(values)
    covariance, share = 1e-4 * np.eye(len(index)), np.full(len(index), 0.99)
    information = np.linalg.inv(covariance)
    return Estimate(
        free, coordinates, 0.0, index, covariance, information, information, share, 1.0, noise
    )


class Found(NamedTuple):
    """What a page needs of a diagnosis besides its summary."""

    split: Split
    names: tuple[str, ...]
    final: Estimate


def outcome_of(verdict: str, currents: tuple[float, ...] = ()) -> Found:
    """What reports need of a diagnosis; with `currents` to the north, one for each run's own."""
    found = verdict in ("explained", "ambiguous")
    runs, held_out = recordings()
    held_out = runs if currents else held_out
    effects = (EFFECTS["current"],)
    problem = make_problem(usv(), list(runs), effects=effects, per_run=bool(currents))
    flow = sum(((speed, 0.0) for speed in currents), ()) or (0.109, 0.280)
    values = {"current": flow} if found else {}
    kind = HeldOut.LAST_PARTS if currents else HeldOut.RECORDINGS
    return Found(
        split=Split(problem, problem, None, runs, held_out, kind),
        names=("current",) if found else (),
        final=estimate_of(problem, values),
    )


@functools.cache
def recordings() -> tuple[tuple[Trajectory, ...], tuple[Trajectory, ...]]:
    """What is fitted and what is held out, all in the same current."""
    true = usv(0.3)
    runs = (recording(NASTY, true), recording("random", true, 1.0))
    return runs, (recording("circle", true, 2.0), recording("zigzag-fast", true, 3.0))


SOURCE = {
    "command": "diffsea diagnose usv.toml *.csv",
    "vessel": "usv.toml (sha256 34cd)",
    "settings": {"environment": "shared", "free": ["X_u", "N_rdot"]},
    "recordings": {"circle": ["not shown twice"]},
    "versions": {"diffsea": "9.9.9"},
}


class Reader(html.parser.HTMLParser):
    """Reads a page: ids, text by section, tags that are not closed in order."""

    VOID = ("meta", "img", "link", "br")

    def __init__(self, page: str):
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.images: list[dict] = []
        self.links: list[str] = []
        self.section = ""
        self.words: dict[str, list[str]] = {}
        self.plots: list[dict] = []  # figures with their text and section
        self.faults: list[str] = []
        self.feed(page)
        self.close()

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        if tag not in self.VOID:
            self.open.append(tag)
        self.ids += [given["id"]] if "id" in given else []
        self.links += [given[key] for key in ("src", "href") if key in given]
        if tag == "section":
            self.section = given["id"]
        if tag == "img":
            self.images.append(given)
        if given.get("class") == "plot":
            self.plots.append({"told": given["aria-label"], "section": self.section})

    def handle_endtag(self, tag):
        if not self.open or self.open.pop() != tag:
            self.faults.append(f"</{tag}> in {self.section}")

    def handle_data(self, data):
        if self.open and self.open[-1] in ("script", "style"):
            if self.section and data.startswith("{"):
                self.plots[-1] |= json.loads(data)
            return
        self.words.setdefault(self.section, []).append(data)

    def drawn(self, section: str) -> list[dict]:
        return [plot for plot in self.plots if plot["section"] == section]

    def text(self, section: str) -> str:
        return " ".join(" ".join(self.words[section]).split())


@functools.cache
def page_of(verdict: str) -> str:
    return page_from(summary_of(verdict), outcome_of(verdict))


def page_from(result: dict, found: Found) -> str:
    """A page with the errors of predictions in its summary, as the command makes it."""
    runs = compared(found)
    return diagnosis_report(with_errors(result, runs), "usv", found.split, runs, SOURCE)


def compared(found: Found) -> list[ComparedRun]:
    """The nominal vessel and the one with the current on every held-out run."""
    runs = found.split.held_out
    before, after = ([RunModel(vessel)] * len(runs) for vessel in (usv(), usv(0.3)))
    return compare(runs, before, after if found.names else None)


def with_errors(result: dict, runs: list[ComparedRun]) -> dict:
    """The summary with the errors of predictions."""
    return result | {"held_out": result["held_out"] | {"horizons": horizon_table(runs)}}


def assert_sound(page: str) -> Reader:
    """One file, tags closed, nothing fetched, every figure told in words."""
    reader = Reader(page)
    assert page.startswith("<!DOCTYPE html>") and "</html>" in page
    assert not reader.faults and not reader.open
    assert len(set(reader.ids)) == len(reader.ids)
    assert all(link.startswith("#") for link in reader.links) and not reader.images
    assert all(len(plot["told"]) > 20 and plot["data"] for plot in reader.plots)
    assert "nan" not in " ".join(" ".join(words) for words in reader.words.values()).split()
    return reader


@pytest.mark.parametrize("verdict", VERDICTS)
def test_every_verdict_has_every_section(verdict):
    reader = assert_sound(page_of(verdict))
    assert tuple(reader.ids) == ("content", *SECTIONS)
    assert all(reader.text(section) for section in SECTIONS)
    assert verdict in reader.text("verdict")
    # Maps of regimes, with an effect also after it; of each recording a map and a track.
    assert len(reader.drawn("where")) == (6 if "current" in reader.text("verdict") else 5)
    # The first run's track stands beside the first sentence.
    assert len(reader.drawn("verdict")) == 1
    assert len(reader.drawn("held-out")) == 3 and len(reader.drawn("what")) == 1


def test_page_shows_the_numbers_of_the_summary():
    reader = assert_sound(page_of("ambiguous"))
    what = reader.text("what")
    assert "0.301 ± 0.004 m/s" in what and "69.0 ± 0.8°" in what and "flows to" in what
    assert "0.295 to 0.307 m/s" in what and "67.7 to 70.3°" in what
    assert "62 %" in what and "1540 ± 130" in what and "wind" in what
    assert "no effect: certain" in what and "next best name: 1800 : 1" in what
    assert '<abbr title="odds of 1×10¹⁴² : 1">certain</abbr>' in page_of("explained")
    assert "1 : 16" in what and "(Y rdot)" in what
    reasons = ("confirmed on held-out runs", "weaker", "its score is <within> chance")
    assert sorted(reasons, key=what.index) == list(reasons)
    where = reader.text("where")
    assert "12 N" in where and "32 N m" in where and "31 to 58 s" in where and "1×10⁻⁶" in where
    parameters = reader.text("parameters")
    assert "−63.9 ± 1.4" in parameters and "−52.0" in parameters and "98 %" in parameters
    assert "0.80 ± 0.05 s" in reader.text("data") and "show faults" in reader.text("verdict")
    then = reader.text("next")
    assert "It separates current from wind" in then and "must run for 140 s" in then
    unseen = reader.text("unseen")
    assert "0.069°/s" in unseen and "not at any plausible size" in unseen
    provenance = reader.text("provenance")
    assert "34cd" in provenance and "12ab" in provenance and "diffsea 9.9.9" in provenance
    assert "free: X_u, N_rdot" in provenance and "not shown twice" not in provenance
    assert "draws: 199" in provenance


def test_maps_have_each_cell_in_its_place():
    given = summary_of("explained")["map"]
    reader = Reader(page_of("explained"))
    nominal, _, first, track, *_ = reader.drawn("where")
    heat = first["data"][0]
    assert heat["y"] == ["surge", "sway", "yaw"] and heat["x"] == pytest.approx(8.7 * np.arange(9))
    for cell in given["time"]:
        if cell["recording"] == NASTY:
            row, column = heat["y"].index(cell["degree_of_freedom"]), round(cell["start"] / 8.7)
            assert heat["z"][row][column] == cell["z"]
    # Sway has z of 2, below the threshold of 3.4; yaw has 4.
    assert set(heat["text"][1]) == {""} and heat["text"][2] == ["", *["−4", "4"] * 3, "−4"]
    heat = nominal["data"][0]
    assert heat["x"] == ["surge", "sway", "yaw"] and heat["z"] == [[0, 0, 0], [0, 4, 8]]
    assert len(track["data"]) == 2 + 2 * 3  # the track, its start, forces before and after
    yaw = track["data"][1]
    assert yaw["meta"]["colouring"] == "N (yaw), nominal model" and yaw["visible"]
    for t, colour in zip(yaw["customdata"], yaw["marker"]["color"], strict=True):
        assert colour == 8.0 * (-1) ** int(t // 8.7) or abs(t / 8.7 - round(t / 8.7)) < 1e-6
    assert min(yaw["customdata"]) > 8.0  # nothing is known of the first window


def test_held_out_runs_are_drawn_in_people_s_units():
    run = recordings()[1][0]
    reader = Reader(page_of("explained"))
    (track,), (times, *_) = reader.drawn("verdict"), reader.drawn("held-out")
    assert [trace["name"] for trace in track["data"]] == ["measured", "nominal", "diagnosed"]
    assert track["data"][0]["x"] == pytest.approx(run.y, abs=0.05)
    assert track["data"][0]["y"] == pytest.approx(run.x, abs=0.05)
    assert track["data"][0]["customdata"] == pytest.approx(run.t)
    panels = [trace for trace in times["data"] if trace["name"] == "measured"]
    for panel, values in zip(panels, (57.29578 * run.psi, 57.29578 * run.r, run.u), strict=False):
        assert panel["y"] == pytest.approx(values, abs=0.02 * np.ptp(values))
    titles = [note["text"] for note in times["layout"]["annotations"]]
    assert titles[0] == "heading (deg)" and titles[1] == "yaw rate (deg/s)"
    assert track["layout"]["meta"]["group"] == times["layout"]["meta"]["group"]


def test_a_page_says_each_number_of_an_accepted_effect_once():
    result = summary_of("explained")
    accepted = next(one for one in result["candidates"] if one["status"] == "accepted")
    alone = {"speed": {"value": 9.87, "std": 0.01, "unit": "m/s"}}
    accepted |= {"parameters": alone, "log10_odds": 5.4, "p_value": 0.02}
    (effect,) = words.named_effects(result)
    ranking = candidate_ranking(result)
    assert ranking is not None
    row = next(row for row in ranking.best.rows if row[1] == "accepted")
    speed = effect["parameters"]["speed"]
    assert interval_of(speed) in row[5] and "9.8" not in row[5]
    assert "certain" in row[2] and "1.3e-9" not in row[3] and "0.02" not in row[3]


def test_detection_limits_say_of_what():
    result = summary_of("explained")
    result["detection_limits"] = [
        {"name": "sensor-latency", "channels": [c], "parameter": "delay", "limit": 0.1, "unit": "s"}
        for c in ("psi", "u")
    ]
    unseen = unseen_table(result)
    assert unseen is not None
    names = [row[0] for row in unseen.rows]
    assert names == ["sensor latency of heading", "sensor latency of speed ahead"]


def test_headings_lie_on_one_turn():
    wrapped = np.array([170.0, 179.0, -172.0, np.nan, -160.0])
    later = np.array([530.0, 539.0, 548.0, 553.0, 560.0])
    t, measured = np.arange(5.0), np.isfinite(wrapped)
    (times, first), (_, second) = on_one_turn([(t[measured], wrapped[measured]), (t, later)])
    assert first == pytest.approx([170, 179, 188, 200]) and times == pytest.approx([0, 1, 2, 4])
    assert second == pytest.approx(later - 360)


def test_page_stays_small_with_long_recordings():
    long = recordings()[0][0]
    t = np.linspace(0, 69.5, 20_000)
    ones = np.ones(t.shape, bool)
    channels = {c: np.interp(t, long.t, getattr(long, c)) for c in ("x", "y", "psi", "u", "v", "r")}
    orders = {c: np.interp(t, long.t, values) for c, values in long.commanded.items()}
    run = dataclasses.replace(long, t=t, valid=ones, commanded=orders, **channels)
    outcome = outcome_of("explained")
    runs = tuple(dataclasses.replace(run, name=f"run {k}") for k in range(16))
    split = dataclasses.replace(outcome.split, recordings=runs)
    result = summary_of("explained")
    cells = [c | {"recording": one.name} for one in runs for c in result["map"]["time"][:8]]
    result["map"]["time"] = result["map_after"]["time"] = cells
    page = page_from(result, Found(split, outcome.names, outcome.final))
    reader = assert_sound(page)
    assert len(page) < 2.8e6
    # All runs are there, the weaker ones folded.
    assert len(reader.drawn("where")) == 2 + 2 * 16 and "10 more runs" in reader.text("where")


def test_page_carries_its_library_once_and_forbids_requests():
    page = page_of("explained")
    (library,) = re.findall(r"\* plotly.js \((\w+) - minified\) v", page)
    assert library == "cartesian" and len(page) < 2.6e6
    assert "Content-Security-Policy" in page and "default-src 'none'" in page


def test_errors_on_the_page_are_those_of_the_models():
    summary = with_errors(summary_of("explained"), compared(outcome_of("explained")))
    rows = {row["seconds"]: row for row in summary["held_out"]["horizons"]}
    assert set(rows) == {5.0, 20.0, 60.0}
    # Two runs of 69.5 s, started every 10 s.
    assert rows[20.0]["starts"] == 10
    # The water carries the vessel 0.3 m/s that the nominal model does not know of.
    assert rows[20.0]["nominal"]["position"] > 4 and rows[20.0]["diagnosed"]["position"] < 1
    old, new = (rows[20.0][model]["position"] for model in ("nominal", "diagnosed"))
    told = f"off by {significant(new, 2)} m with what was found, instead of {significant(old, 2)} m"
    assert told in Reader(page_of("explained")).text("verdict")
    assert told in " ".join(verdict_text(summary).split())


def test_names_from_files_are_escaped():
    page = page_of("explained")
    assert "0.80 s <script>" not in page and "<b>file" not in page and "zig<zag>" not in page
    assert NASTY in Reader(page).text("where")
    parts: Any = TEMPLATES.get_template("parts.html.j2").module
    shown = Plot(figure(title={"text": "</script><b>"}), "a plot <of> nothing at all", 100)
    drawn = parts.plot(shown)
    assert drawn.count("</script>") == 1 and "<of>" not in drawn and "<b>" not in drawn
    cell = TEMPLATES.from_string("{{ cell }}")
    assert cell.render(cell='a <b> & "c"') == "a &lt;b&gt; &amp; &#34;c&#34;"
    assert cell.render(cell="-1 +- 2") == "−1 ± 2"
    assert cell.render(cell=Verbatim("run-1 -1 <c>")) == "run-1 -1 &lt;c&gt;"


def test_a_current_of_each_run_is_its_own():
    found = outcome_of("explained", currents=(0.5, -0.5))
    runs, own = found.split.held_out, held_out_models(found.split, found.final)
    ahead, astern = compare(runs, [RunModel(usv())] * len(runs), own)
    for run, sign in ((ahead, 1), (astern, -1)):
        drift = run.predictions["diagnosed"].run.x - run.predictions["nominal"].run.x
        assert drift[-1] == pytest.approx(sign * 0.5 * 69.5, rel=0.05)


def test_one_model_where_nothing_was_found():
    reader = assert_sound(page_of("consistent"))
    assert "nominal →" not in reader.text("held-out")
    assert "predicts" in reader.text("held-out")


def test_predictions_that_diverge_stand_beside_the_errors_of_the_others():
    row = {"seconds": 20.0, "starts": 9, "nominal": {"position": 4.0, "diverged": 3},
           "diagnosed": {"position": 1.0}}  # fmt: skip
    said = horizon_line(row, ("nominal", "diagnosed"))
    assert said == "20 s ahead: position 4.0 m -> 1.0 m (3 -> 0 of 9 diverge)"
    gone = row | {"diagnosed": {"diverged": 9}}
    assert "nothing to compare (3 -> 9 of 9" in horizon_line(gone, ("nominal", "diagnosed"))
    assert "diverge" not in horizon_line(row, ("diagnosed",))


def test_errors_of_runs_count_by_the_predictions_that_they_are_of():
    measured = recording("straight", usv())

    def one(errors: dict[str, float]) -> ComparedRun:
        return ComparedRun(measured, {"nominal": Prediction(measured, {20.0: errors})})

    runs = [one({"u": 3.0, "starts": 9, "diverged": 8}), one({"u": 1.0, "starts": 7})]
    (row,) = horizon_table(runs)
    assert row["starts"] == 16
    assert row["nominal"] == {"u": pytest.approx(math.sqrt((9 + 7) / 8)), "diverged": 8}


def test_runs_of_which_every_prediction_diverges_are_the_worst_and_those_too_short_the_best():
    measured = recording("straight", usv())

    def one(errors: dict[float, dict[str, float]]) -> ComparedRun:
        return ComparedRun(measured, {"nominal": Prediction(measured, errors)})

    short, slow = one({}), one({20.0: {"u": 0.2, "starts": 9}})
    far, gone = (one({20.0: errors}) for errors in (
        {"position": 5.0, "u": 0.1, "starts": 9}, {"starts": 9, "diverged": 9}
    ))  # fmt: skip
    assert worst_predicted([short, far, gone, slow], ["nominal"], 4) == [gone, far, slow, short]


def test_a_page_says_where_what_was_found_does_not_improve_the_motion():
    horizons = [{"seconds": seconds, "starts": 9, "nominal": {"position": 1.0},
                 "diagnosed": {"position": new}}
                for seconds, new in ((5.0, 0.5), (20.0, 1.2), (60.0, 1.1))]  # fmt: skip
    summary = {"effects": [{"name": "current", "parameters": {}}],
               "held_out": {"horizons": horizons}}  # fmt: skip
    assert "not the motion 20 s and 60 s ahead" in unimproved_sentence(summary)
    assert unimproved_sentence(summary | {"held_out": {"horizons": horizons[:1]}}) == ""
    assert unimproved_sentence(summary | {"effects": []}) == ""
    for (old, new), row in zip(((0.1, 0.05), (0.1, 0.109), (0.1, 0.12)), horizons, strict=True):
        row["nominal"] |= {"position": 3.0, "heading": old}
        row["diagnosed"]["heading"] = new
    told = unimproved_sentence(summary)
    assert told == "Predicted worse with it: heading 60 s ahead (5.7 deg -> 6.9 deg)."
    whole = summary_of("explained")
    whole["held_out"] |= {"horizons": horizons}
    assert told in " ".join(verdict_text(whole).split())


def test_what_explains_single_steps_alone_is_told_unless_another_kind_of_it_was_accepted():
    refused = {"name": "added-mass-coupling", "predicts_motion": False}
    told = {"effects": [], "candidates": [refused, refused]}
    assert single_step_sentence(told) == (
        "Added mass coupling explains single steps, but not the motion: no name is given."
    )
    assert single_step_sentence(told | {"effects": [{"name": "added-mass-coupling"}]}) == ""


@pytest.mark.parametrize("held_out", [True, False])
def test_fit_page(held_out):
    runs, test = recordings()
    quality = {"train": 1.02} | ({"test": 1.31} if held_out else {})
    history = ["round 1: -2 log posterior -20.1", "round 2: <done>"]
    seen = list(test) if held_out else list(runs)
    shown = [
        ComparedRun(r, {"start": predict(usv(), r), "fitted": predict(usv(0.3), r)}) for r in seen
    ]
    verdict = FitVerdict(None, 1e-4, held_out)
    page = fit_report(
        study(), quality, history, shown, (list(runs), list(test) * held_out), SOURCE, verdict
    )
    reader = assert_sound(page)
    sections = ("summary", "parameters", "open", "predictions", "convergence", "provenance")
    assert tuple(reader.ids) == ("content", *sections)
    assert "N_rdot" in reader.text("summary") and "−52.0 ± 0.5" in reader.text("parameters")
    assert "Anchored by <mass>" in reader.text("parameters")
    assert "linear damping in surge" in reader.text("parameters")
    assert "7 of 8 starts" in reader.text("open") and "2 of x" in reader.text("open")
    assert "1.00 N_rdot (the data determine" in reader.text("open")
    assert "Something is missing: trial numbers" in reader.text("summary")
    assert ("1.31 times in what was held out" in reader.text("summary")) is held_out
    assert ("worse than the vessel file" in reader.text("summary")) is (worse_warning(shown) != "")
    swapped = [
        ComparedRun(
            o.recording, {"start": o.predictions["fitted"], "fitted": o.predictions["start"]}
        )
        for o in shown
    ]
    assert worse_warning(shown) == "" and "predicts position" in worse_warning(swapped)
    assert ("none were held out" in reader.text("predictions")) is not held_out
    assert "round 2: <done>" in reader.text("convergence")
    assert ("circle" in reader.text("predictions")) is held_out


def test_fit_page_of_a_start_that_diverges():
    found = study()
    path = (math.nan, 50.0, 2.0, 1.0)
    found = dataclasses.replace(found, estimate=dataclasses.replace(found.estimate, path=path))
    runs = list(recordings()[0])
    shown = [ComparedRun(r, {"start": predict(usv(), r), "fitted": predict(usv(0.3), r)})
             for r in runs]  # fmt: skip
    verdict = FitVerdict(None, 1e-4, False)
    page = fit_report(found, {"train": 1.02}, [], shown, (runs, []), SOURCE, verdict)
    assert "cost above its minimum" in page


def test_rivals_of_what_was_found_are_told_where_something_is_left():
    summary = summary_of("ambiguous") | {"verdict": "unexplained"}
    text = " ".join(verdict_text(summary).split())
    told = "(or else wind: these recordings cannot tell which), which the model leaves out, and som"
    assert told in text
    assert "; odds over 1e6 : 1; wind would do as well" in text
    alone = " ".join(verdict_text(summary_of("explained")).split())
    assert "would do as well" not in alone and "or else" not in alone


def test_what_would_do_as_well_as_one_of_several_stands_behind_that_one():
    summary = summary_of("ambiguous")
    (current,) = summary["effects"]
    sure = current | {"name": "gyro-bias", "parameters": {}, "alternatives": []}
    told = verdict_sentence(summary | {"effects": [current, sure]})
    assert "(or else wind: these recordings cannot tell which) and" in told
    first = verdict_sentence(summary | {"effects": [sure, current]})
    assert first.endswith("(or else wind: these recordings cannot tell which).")


def test_verdict_text_of_each_verdict():
    explained = verdict_text(summary_of("explained"))
    told = " ".join(explained.split())
    assert told.startswith("On runs kept back as a test, ")  # errors first
    assert "The recordings show a steady current of 0.30 m/s flowing to 69 deg," in told
    assert "speed 0.301 +- 0.004 m/s, direction 69.0 +- 0.8 deg (flows to)" in told
    assert "from 9.0 to 1.1 times the noise" in told and "(flows to); odds over 1e6 : 1" in told
    ambiguous = verdict_text(summary_of("ambiguous"))
    told = " ".join(ambiguous.split())
    assert "or else wind: these recordings cannot tell which" in told
    assert "turning circle for 140 s: separates current from wind" in told
    unexplained = " ".join(verdict_text(summary_of("unexplained")).split())
    assert "no effect known here describes, strongest in sway" in unexplained
    consistent = verdict_text(summary_of("consistent"))
    assert "The model agrees with the recordings" in consistent
    told = " ".join(verdict_text(summary_of("insufficient")).split())
    assert "do not tell whether the model lacks anything: most parameters are not" in told
    assert "free predictions go further astray" in told
    assert "what" not in consistent.split("\n\n")[-1].split()
    assert all(len(line) <= 88 for line in explained.splitlines() + ambiguous.splitlines())


def test_names_that_leave_held_out_runs_wrong_are_told():
    summary = summary_of("unexplained") | {"remainder_p_value": 0.2}
    told = " ".join(verdict_text(summary).split())
    assert "(p = 0.20), but runs held out are still predicted worse than noise explains." in told
    assert "held out are still" not in verdict_text(summary_of("unexplained"))


def test_how_a_recording_is_misread_stands_at_the_head_with_its_repair():
    summary = summary_of("unexplained")
    sign = {"kind": "sign", "message": "positive rudder turns to port", "repair": "rudder = -1",
            "channels": ["rudder"], "value": -0.2, "std": 0.01, "unit": "1"}  # fmt: skip
    summary["audit"] = [sign | {"recording": name} for name in ("one", "two")]
    told = "positive rudder turns to port (in 2 recordings). Repair: rudder = -1."
    text = " ".join(verdict_text(summary).split())
    assert text.count(told) == 1 and text.index(told) < text.index("The recordings show")
    assert "data " not in text
    page = page_from(summary, outcome_of("unexplained"))
    assert told in page[page.index('id="verdict"') : page.index('id="held-out"')]


def test_a_fault_of_several_recordings_is_told_once_with_its_sizes():
    late = {"kind": "sensor-latency", "message": "heading lags", "channels": ["psi"], "unit": "s"}
    found = [late | {"recording": name, "value": value}
             for name, value in (("one", 0.936), ("two", 0.774), ("three", 0.8))]  # fmt: skip
    text = " ".join(verdict_text(summary_of("explained") | {"audit": found}).split())
    assert "sensor latency in one: heading lags; and in 2 more, 0.774 s to 0.936 s" in text
    assert text.count("heading lags") == 1
    text = " ".join(verdict_text(summary_of("explained") | {"audit": found[:1]}).split())
    assert "sensor latency in one: heading lags" in text and "more" not in text.split("lags")[1]


def test_faults_that_differ_are_not_put_together():
    turned = {"kind": "axes", "message": "turned", "channels": ["psi"], "value": None}
    found = [turned | {"recording": name, "repair": repair}
             for name, repair in (("A", "offset = -0.1"), ("B", "offset = 1.5"))]  # fmt: skip
    gap = {"kind": "gap", "channels": ["t"], "recording": "A", "unit": "s"}
    found += [gap | {"message": text, "value": 1.0} for text in ("cut off", "a clock gap")]
    doubted = turned | {"recording": "C", "repair": "none", "doubt": "or else late"}
    summary = summary_of("unexplained") | {"audit": [*found, doubted]}
    text = " ".join(verdict_text(summary).split())
    assert "turned (in A). Repair: offset = -0.1." in text
    assert "turned (in B). Repair: offset = 1.5." in text
    assert "gap in A: cut off gap in A: a clock gap axes in C: turned" in text


def test_what_is_needed_only_together_and_what_little_is_left_are_told():
    sizes = {name: {"value": 2.0, "std": std, "unit": "kg m"} for name, std in
             (("Y_rdot", 4.0), ("N_vdot", 3.0))}  # fmt: skip
    effect = CURRENT | {"name": "added-mass-coupling", "parameters": sizes}
    errors = {"nominal": {"position": 7.7}, "diagnosed": {"position": 0.077}}
    summary = summary_of("unexplained") | {"effects": [effect], "remainder_p_value": 1e-5}
    summary["held_out"] |= {"horizons": [{"seconds": 20.0, "starts": 9, **errors}]}
    text = " ".join(verdict_text(summary).split())
    assert "(needed together, none determined by itself)" in text
    assert "of the error of position 20 s ahead 1.0 % is left." in text
    found = outcome_of("explained")
    page = diagnosis_report(summary, "usv", found.split, compared(found), SOURCE)
    assert '<section id="verdict" class="verdict ambiguous">' in page
    sizes["Y_rdot"]["std"], errors["diagnosed"]["position"] = 0.5, 7.0
    text = " ".join(verdict_text(summary).split())
    assert "none determined" not in text and "is left" not in text
    errors["diagnosed"]["position"] = 8.0
    page = diagnosis_report(summary, "usv", found.split, compared(found), SOURCE)
    assert '<section id="verdict" class="verdict unexplained">' in page


def test_channels_that_are_used_seldom_are_told():
    summary = summary_of("explained") | {"one_sample_in": {"v": 5, "r": 3}}
    told = "only one sample in 5 of speed to starboard and one sample in 3 of yaw rate counted."
    assert told in " ".join(verdict_text(summary).split())
    assert "counted" not in verdict_text(summary_of("explained"))


def test_several_late_sensors_are_one_phrase():
    delays = {("psi", "u", "v", "r"): 0.26, ("x", "y"): 0.23}
    late = [
        {
            "name": "sensor-latency",
            "channels": channels,
            "parameters": {"delay": {"value": delay, "std": 0.01, "unit": "s"}},
            "evidence": {},
            "alternatives": [],
        }
        for channels, delay in delays.items()
    ]
    told = "late measurements (heading, velocity and yaw rate by 0.26 s; position by 0.23 s), which"
    text = verdict_text(summary_of("explained") | {"effects": late})
    assert told in " ".join(text.split())
    text = verdict_text(summary_of("explained") | {"effects": late[:1]})
    assert "a measured position that is 0.26 s ahead of all else" in " ".join(text.split())


def test_several_effects_and_effects_of_each_run():
    lag = CURRENT | {
        "name": "thrust-lag",
        "parameters": {"time_constant": {"value": 0.83, "std": 0.05, "unit": "s"}},
    }
    both = summary_of("explained") | {"effects": [CURRENT, lag]}
    text = " ".join(verdict_text(both).split())
    assert "flowing to 69 deg and a lag with a time constant of 0.83 s in the actuators" in text
    assert "The recordings show a steady current" in text
    speeds = {
        name: {"speed": {"value": value, "std": 0.01, "unit": "m/s"}}
        for name, value in (("one", 0.21), ("two", 0.34))
    }
    own = [CURRENT | {"recording": name, "parameters": s} for name, s in speeds.items()]
    text = " ".join(verdict_text(summary_of("explained") | {"effects": own}).split())
    assert "of its own in each recording (speed 0.210 m/s to 0.340 m/s), which" in text
    assert "current in two: speed 0.340 +- 0.010 m/s" in text


def test_what_acts_on_some_actuators_says_on_which():
    time = {"value": 592.0, "std": 0.2, "unit": "s"}
    factor = {"value": -0.42, "std": 0.01, "unit": "1"}
    weaker = {"name": "thrust-change", "parameters": {"time": time, "factor": factor}}
    assert phrase(weaker) == "a thrust that is 42 % smaller from 592 s on"
    told = phrase(weaker | {"actuators": ["starboard"]})
    assert told == "a thrust of the starboard actuator that is 42 % smaller from 592 s on"
    told = phrase(weaker | {"actuators": ["bow.force", "stern.force"]})
    assert "of the bow thruster and stern thruster that is" in told
    slow = {
        "name": "thrust-delay",
        "parameters": {"delay": {"value": 0.3, "std": 0.1, "unit": "s"}},
    }
    assert "stern thruster's angle" in phrase(slow | {"actuators": ["stern.angle"]})


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_every_effect_has_a_phrase(name):
    effect = EFFECTS[name]
    parameters = {
        key: {"value": 0.1, "std": 0.01, "unit": unit} for key, unit in effect.units.items()
    }
    text = phrase({"name": name.split(":")[0], "parameters": parameters})
    assert "{" not in text and "effect" not in text and "unknown" not in text


@pytest.mark.parametrize(
    ("value", "std", "unit", "text"),
    [
        (0.3012, 0.0042, "m/s", "0.301 +- 0.004 m/s"),
        (0.3012, 0.0142, "m/s", "0.301 +- 0.014 m/s"),
        (1.2043, 0.0141, "rad", "69.0 +- 0.8 deg"),
        (0.01, 0.0005, "rad/s", "0.57 +- 0.03 deg/s"),
        (12345.6, 321.0, "N", "12300 +- 300 N"),
        (0.1, 0.03, "1", "0.10 +- 0.03"),
        (-0.001, 0.4, "s", "0.0 +- 0.4 s"),
        (5.0, 0.0, "s", "5.00 s"),
        (5.0, 0.0, "1", "5"),
        (5.0, math.nan, "s", "5.00 s"),
        (None, None, "s", "not known"),
        (9.99, 0.0996, "m", "10.0 +- 0.1 m"),
        (5.8e8, 1.1e8, "N m/rad", "(5.8 +- 1.1)e8 N m/rad"),
        (-4.81e6, 1.6e6, "N/rad", "(-4.8 +- 1.6)e6 N/rad"),
        (999999.0, 20000.0, "N", "1000000 +- 20000 N"),
        (300.0, 4e6, "N", "(0 +- 4)e6 N"),
    ],
)
def test_rounding_with_error(value, std, unit, text):
    assert with_error(value, std, unit) == text


def test_rounding_alone():
    assert round_to_error(0.3012, 0.0042, "m/s") == "0.30 m/s"
    assert round_to_error(2.1, 0.01, "rad") == "120 deg"
    assert with_error(0.2513, 0.004, "rad per s") == "14.4 +- 0.2 deg/s"  # of a rudder
    assert round_to_error(2.15, 0.01, "rad") == "123 deg"
    assert round_to_error(5.8e8, 1.1e8, "N m/rad") == "5.8e8 N m/rad"
    assert typeset("(5.8 +- 1.1)e8 N") == "(5.8 ± 1.1)×10⁸ N"
    assert round_to_error(1234.0, 30.0, "kg") == "1230 kg"
    assert significant(0.0, 3) == "0" and significant(1.3e-9, 2) == "1.3e-9"
    assert significant(12345678.0, 3) == "1.23e7" and significant(999.6, 3) == "1000"
    assert probability(1.3e-9) == "1e-9" and probability(0.0312) == "0.031"
    assert probability(0.0) == "< 1e-99" and probability(1.0) == "1.0"


def test_odds_intervals_and_durations():
    assert [odds(x) for x in (0.0, 1.0, 2.93, 142.3)] == ["1 : 1", "10 : 1", "850 : 1", "1e142 : 1"]
    assert odds(-1.5) == "1 : 32" and odds(None) == "not known"
    assert interval((0.2951, 0.3073), "m/s") == "0.295 to 0.307 m/s"
    assert interval((-0.5, 0.5), "rad") == "-29 to 29 deg"
    assert interval((1.5, math.inf), "kg") == "1.50 to open kg"
    assert [duration(x) for x in (143.0, 600.0, 86400.0)] == ["140 s", "10 min", "24 h"]


def test_commands_in_messages_are_code_and_nothing_else_becomes_markup():
    assert with_commands("see `diffsea fit a.toml` -> <b>") == (
        "see <code>diffsea fit a.toml</code> -&gt; &lt;b&gt;"
    )
    assert with_commands("`<i>`") == "<code>&lt;i&gt;</code>"
    assert with_commands("a `lone one") == "a `lone one"


def test_typesetting():
    assert typeset("69.0 +- 0.8 deg") == "69.0 ± 0.8°"
    assert typeset("p = 1e-9; N s^2/m^2") == "p = 1×10⁻⁹; N s²/m²"
    assert typeset("9.24e-05 deg/s") == "9.24×10⁻⁵°/s" and typeset("2e12") == "2×10¹²"
    assert typeset("-3.2 -> 0.1 deg/s") == "−3.2 → 0.1°/s"
    assert typeset("zigzag-20 and run3e5") == "zigzag-20 and run3e5"


def test_a_change_says_by_how_much_of_what_there_was_and_a_stage_which_actuators():
    def said(name, **record):
        sizes = record.pop("sizes")
        entries = {key: {"value": v, "std": s, "unit": u} for key, (v, s, u) in sizes.items()}
        return phrase({"name": name, "parameters": entries, **record})

    at = (60.2, 0.2, "s")
    grown = said("drag-change", sizes={"time": at, "factor": (0.396, 0.012, "1")})
    assert grown == "a drag that is 40 % larger from 60 s on"
    ahead = {"degrees_of_freedom": ["surge"]}
    fouled = said("drag-change", sizes={"time": at, "factor": (0.396, 0.012, "1")}, **ahead)
    assert fouled == "a drag ahead that is 40 % larger from 60 s on"
    lost = said("thrust-change", sizes={"time": at, "factor": (-0.25, 0.01, "1")})
    assert lost == "a thrust that is 25 % smaller from 60 s on"
    lighter = said("mass-change", sizes={"time": at, "mass": (-13.2, 0.5, "kg")})
    assert lighter == "a mass that is 13 kg smaller from 60 s on"
    slow = said("thrust-lag", sizes={"time_constant": (0.6, 0.02, "s")}, actuators=["rudder"])
    assert slow == "a lag with a time constant of 0.60 s in the rudder"
    late = {"delay": (0.48, 0.009, "s"), "time_constant": (0.62, 0.01, "s")}
    one = said("actuator-response", sizes=late, actuators=["port"])
    told = "that is 0.48 s late, with a time constant of 0.62 s"
    assert one == f"an answer of the port actuator {told}"
    assert said("actuator-response", sizes=late) == f"an answer of the actuators {told}"


def test_the_terminal_says_which_actuators_and_channels_an_effect_acts_on():
    result = summary_of("explained")
    delay = {"delay": {"value": 0.5, "std": 0.01, "unit": "s"}}
    late = {"parameters": delay, "evidence": {}, "alternatives": []}
    one = {"name": "thrust-delay", "actuators": ["port"], **late}
    other = {"name": "sensor-latency", "channels": ["u", "v"], **late}
    text = verdict_text(result | {"effects": [one, other]})
    assert "thrust delay of port: delay 0.500 +- 0.010 s" in text
    assert "sensor latency of velocity: delay" in text


def test_what_was_held_out_is_told_by_its_kind_and_not_by_the_words_for_it():
    found = outcome_of("explained")
    split = dataclasses.replace(found.split, kind=HeldOut.LAST_PARTS)
    held_out = {"kind": "last parts", "how": "other words", "recordings": ["circle"],
                "horizons": []}  # fmt: skip
    result = summary_of("explained") | {"held_out": held_out}
    page = page_from(result, found._replace(split=split))
    assert "the last part of each held out" in Reader(page).text("")
    assert "On the last part of each run, kept back" in Reader(page).text("verdict")
    result["held_out"] = held_out | {"kind": "recordings", "how": "the last part of each run"}
    assert "on runs kept back as a test" in verdict_text(result).lower()


def test_fit_page_of_recordings_and_trial_numbers_says_what_each_tells():
    """Sources as if found; the numbers are those that the table is made of."""
    known = Identifiability((), (), 1.0)
    recordings_alone = Source(181.0, 160, {"X_u": 0.97, "N_rdot": 0.1}, known)
    numbers_alone = Source(2.5, 3, {"X_u": 0.2, "N_rdot": 0.8}, known)
    both = Sources(recordings_alone, numbers_alone, 1.5, {"X_u": 0.98, "N_rdot": 0.85}, 0.48)
    found = dataclasses.replace(study(), sources=both)
    runs, _ = recordings()
    shown = [ComparedRun(runs[0], {m: predict(usv(), runs[0]) for m in ("start", "fitted")})]
    verdict = FitVerdict(None, 0.48, False)
    page = fit_report(found, {"train": 1.0}, [], shown, (list(runs), []), SOURCE, verdict)
    told = assert_sound(page).text("sources")
    assert "N_rdot 10 % 80 % 85 %" in " ".join(told.split())
    assert "181 in 160 values" in told and "2.50 in 3 values" in told
    assert "by the trial numbers alone, not by the recordings: N_rdot" in told
    assert "Nothing is missing as far as these data tell" in Reader(page).text("summary")


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("time_constant", "time constant"),
        ("Y_ur", "Y_ur (sway force from u r)"),
        ("C_N", "C_N (wind coefficient in yaw)"),
        ("gamma_R", "gamma_R (straightening of the rudder's inflow)"),
        ("x_G", "x_G (centre of gravity forward of amidships)"),
    ],
)
def test_symbols_of_an_effect_are_told_with_their_meaning(name, told):
    entry = {"value": 1.0, "std": 0.1, "unit": "1"}
    lines = words.parameter_lines({"name": "current", "parameters": {name: entry}})
    assert lines == [f"{told} 1.00 +- 0.10"]


def test_every_parameter_of_the_catalogue_is_in_words():
    names = {key for effect in EFFECTS.values() for key in effect.units}
    symbols = {name for name in names if name[0].isupper() or name.endswith(("_H", "_R", "_G"))}
    assert symbols and all("(" in words.parameter_words(name) for name in symbols)
