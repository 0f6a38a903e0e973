"""Reports: every section for every verdict, nothing unescaped, the summary's own numbers."""

import dataclasses
import functools
import html.parser
import math
import pathlib

import numpy as np
import pytest

from diffsea.diagnosis.locate import Cell
from diffsea.diagnosis.score import Score
from diffsea.diagnosis.select import Accepted, Diagnosis, Fitted
from diffsea.identification.estimates import Estimate
from diffsea.identification.holdout import Gain, Split
from diffsea.identification.identifiability import identifiability
from diffsea.identification.objectives import Innovations
from diffsea.identification.problem import Problem, make_problem
from diffsea.identification.starts import Agreement
from diffsea.identification.study import Study
from diffsea.report.comparison import Comparison, compare, predict, with_held_out_errors
from diffsea.report.diagnosis_page import diagnosis_report
from diffsea.report.fit_page import fit_report, worse
from diffsea.report.page import markup
from diffsea.report.quantities import probability, rounded, significant, typeset, with_error
from diffsea.report.text import phrase, verdict_text
from diffsea.simulation.replay import replay
from diffsea.types import Trajectory
from diffsea.vessel.base import Vessel
from diffsea.vessel.catalogue import build, read_vessel
from diffsea.vessel.effects import EFFECTS


USV = pathlib.Path(__file__).parent / "oracle" / "usv.toml"
NASTY = 'zig<zag> & "20".csv'
SECTIONS = (
    "verdict", "audit", "where", "what", "before-and-after", "parameters", "remains", "provenance",
)  # fmt: skip
VERDICTS = ("consistent", "explained", "ambiguous", "unexplained")


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


def cells(runs: int, strength: float) -> tuple[Cell, ...]:
    """Cells whose significance grows with the degree and the window."""
    out = []
    for run in range(runs):
        for k in range(8):
            for degree in range(3):
                p = 10.0 ** (-strength * degree * ((k + run) % 4))
                out.append(Cell(degree, run, 8.7 * k, 8.7 * (k + 1), "", 12.3 * degree, 2.1, p))
    for degree in range(3):
        for k, regime in enumerate(("drift angle 0 to 8 deg", "drift angle 8 to 21.5 deg")):
            p = 10.0 ** (-2 * strength * degree * k)
            out.append(Cell(degree, None, math.nan, math.nan, regime, 7.0, 1.0, p))
    return tuple(out)


CURRENT = {
    "name": "current",
    "parameters": {
        "speed": {"value": 0.3012, "std": 0.0042, "unit": "m/s"},
        "direction": {"value": 1.2043, "std": 0.0141, "unit": "rad"},
    },
    "evidence": {
        "score": 812.4, "p_value": 1.3e-9, "cost_drop": 0.62, "held_out_gain": 1540.0,
        "held_out_gain_std": 130.0,
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
    screening = [
        {"name": "current", "score": 812.4, "p_value": 1.3e-9, "inflation": 1.4, "bic": 655.2,
         "held_out_gain": 1540.0, "held_out_gain_std": 130.0, "possible": True},
        {"name": "sensor-latency:yaw_rate", "score": 30.1, "p_value": 0.031, "inflation": 1.0},
    ]  # fmt: skip
    return {
        "format": 1,
        "verdict": verdict,
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
        "held_out": {"how": "whole recordings", "recordings": ["circle"]},
        "screening": screening,
        "remainder_p_value": 1e-7 if verdict == "unexplained" else 0.4,
        "next_experiment": {"manoeuvre": "turning-circle", "why": "separates current from wind"}
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
        coordinates[problem.layout.slices()[name]] = copies.ravel()
    index = np.arange(len(coordinates))
    free = tuple(p.name for p in problem.layout.parameters) + tuple(values)
    covariance, share = 1e-4 * np.eye(len(index)), np.full(len(index), 0.99)
    information = np.linalg.inv(covariance)
    return Estimate(
        free, coordinates, 0.0, index, covariance, information, information, share, 1.0, noise
    )


def diagnosis_of(verdict: str, currents: tuple[float, ...] = ()) -> Diagnosis:
    """A diagnosis as if made; with `currents` to the north, one for each run's own."""
    found = verdict in ("explained", "ambiguous")
    runs, held_out = recordings()
    held_out = runs if currents else held_out
    effects = (EFFECTS["current"],)
    problem = make_problem(usv(), list(runs), effects=effects, per_run=bool(currents))
    flow = sum(((speed, 0.0) for speed in currents), ()) or (0.109, 0.280)
    nominal, final = estimate_of(problem, {}), estimate_of(problem, {"current": flow})
    score = Score(812.4, 1.3e-9, np.zeros(2), 1.4)
    fitted = Fitted("current", final, 900.0, 2, 1680.0, Gain(1540.0, 130.0), score, True)
    return Diagnosis(
        verdict=verdict,
        split=Split(problem, problem, None, runs, held_out, bool(currents)),
        nominal=nominal,
        final=final if found else nominal,
        effects=(Accepted("current", fitted, ()),) if found else (),
        screened={"current": score},
        refitted=(fitted,),
        before=cells(2, 0.0 if verdict == "consistent" else 2.0),
        after=cells(2, 2.0 if verdict == "unexplained" else 0.0),
        remainder=1e-7 if verdict == "unexplained" else 0.4,
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

    def handle_endtag(self, tag):
        if not self.open or self.open.pop() != tag:
            self.faults.append(f"</{tag}> in {self.section}")

    def handle_data(self, data):
        self.words.setdefault(self.section, []).append(data)

    def text(self, section: str) -> str:
        return " ".join(" ".join(self.words[section]).split())


@functools.cache
def page_of(verdict: str) -> str:
    diagnosis = diagnosis_of(verdict)
    diagnosed = usv(0.3) if diagnosis.effects else usv()
    return diagnosis_report(summary_of(verdict), diagnosis, usv(), diagnosed, SOURCE)


def assert_sound(page: str) -> Reader:
    """One file, tags closed, nothing fetched, every figure told in words."""
    reader = Reader(page)
    assert page.startswith("<!DOCTYPE html>") and "</html>" in page
    assert not reader.faults and not reader.open
    assert len(set(reader.ids)) == len(reader.ids)
    assert all(link.startswith("data:image/svg+xml;base64,") for link in reader.links)
    assert all(len(image["alt"]) > 20 for image in reader.images)
    assert "nan" not in " ".join(" ".join(words) for words in reader.words.values()).split()
    return reader


@pytest.mark.parametrize("verdict", VERDICTS)
def test_every_verdict_has_every_section(verdict):
    reader = assert_sound(page_of(verdict))
    assert tuple(reader.ids) == SECTIONS
    assert all(reader.text(section) for section in SECTIONS)
    assert verdict in reader.text("verdict")
    assert len(reader.images) >= 6


def test_page_shows_the_numbers_of_the_summary():
    reader = assert_sound(page_of("ambiguous"))
    what = reader.text("what")
    assert "0.301 ± 0.004 m/s" in what and "69.0 ± 0.8°" in what and "flows to" in what
    assert "62 %" in what and "1540 ± 130" in what and "655" in what and "wind" in what
    where = reader.text("where")
    assert "12 N" in where and "32 N m" in where and "31 to 58 s" in where and "1×10⁻⁶" in where
    parameters = reader.text("parameters")
    assert "−63.9 ± 1.4" in parameters and "−52.0" in parameters and "98 %" in parameters
    assert "0.80 ± 0.05 s" in reader.text("audit")
    assert "separates current from wind" in reader.text("remains")
    provenance = reader.text("provenance")
    assert "34cd" in provenance and "12ab" in provenance and "diffsea 9.9.9" in provenance
    assert "free: X_u, N_rdot" in provenance and "not shown twice" not in provenance


def test_errors_on_the_page_are_those_of_the_models():
    diagnosis = diagnosis_of("explained")
    summary = with_held_out_errors(summary_of("explained"), diagnosis, usv(), usv(0.3))
    rows = {row["seconds"]: row for row in summary["held_out"]["horizons"]}
    assert set(rows) == {5.0, 20.0, 60.0}
    # Two runs of 69.5 s, started every 10 s.
    assert rows[20.0]["starts"] == 10
    # The water carries the vessel 0.3 m/s that the nominal model does not know of.
    assert rows[20.0]["nominal"]["position"] > 4 and rows[20.0]["diagnosed"]["position"] < 1
    old, new = (rows[20.0][model]["position"] for model in ("nominal", "diagnosed"))
    told = f"falls from {significant(old, 2)} m to {significant(new, 2)} m"
    assert told in Reader(page_of("explained")).text("verdict")
    assert told in verdict_text(summary)


def test_names_from_files_are_escaped():
    page = page_of("explained")
    assert "<script>" not in page and "<b>file" not in page and "zig<zag>" not in page
    assert NASTY in Reader(page).text("where")
    assert markup('a <b> & "c"') == "a &lt;b&gt; &amp; &quot;c&quot;"


def test_a_current_of_each_run_is_its_own():
    diagnosis = diagnosis_of("explained", currents=(0.5, -0.5))
    ahead, astern = compare(diagnosis, usv(), usv())
    for run, sign in ((ahead, 1), (astern, -1)):
        drift = run.predictions["diagnosed"].run.x - run.predictions["nominal"].run.x
        assert drift[-1] == pytest.approx(sign * 0.5 * 69.5, rel=0.05)


def test_one_model_where_nothing_was_found():
    reader = assert_sound(page_of("consistent"))
    assert "nominal →" not in reader.text("before-and-after")
    assert "predicts" in reader.text("before-and-after")


@pytest.mark.parametrize("held_out", [True, False])
def test_fit_page(held_out):
    runs, test = recordings()
    quality = {"train": 1.02} | ({"test": 1.31} if held_out else {})
    history = ["round 1: -2 log posterior -20.1", "round 2: <done>"]
    seen = list(test) if held_out else list(runs)
    shown = [
        Comparison(r, {"start": predict(usv(), r), "fitted": predict(usv(0.3), r)}) for r in seen
    ]
    page = fit_report(study(), quality, history, shown, (list(runs), list(test) * held_out), SOURCE)
    reader = assert_sound(page)
    sections = ("summary", "parameters", "open", "predictions", "convergence", "provenance")
    assert tuple(reader.ids) == sections
    assert "N_rdot" in reader.text("summary") and "−52.0 ± 0.5" in reader.text("parameters")
    assert "Anchored by <mass>" in reader.text("parameters")
    assert "linear damping in surge" in reader.text("parameters")
    assert "7 of 8 starts" in reader.text("open") and "2 of x" in reader.text("open")
    assert "1.00 N_rdot (the data determine" in reader.text("open")
    assert ("1.31 times in what was held out" in reader.text("summary")) is held_out
    assert ("worse than the vessel file" in reader.text("summary")) is (worse(shown) != "")
    swapped = [
        Comparison(
            o.recording, {"start": o.predictions["fitted"], "fitted": o.predictions["start"]}
        )
        for o in shown
    ]
    assert worse(shown) == "" and "predicts position" in worse(swapped)
    assert ("none were held out" in reader.text("predictions")) is not held_out
    assert "round 2: <done>" in reader.text("convergence")
    assert ("circle" in reader.text("predictions")) is held_out


def test_verdict_text_of_each_verdict():
    explained = verdict_text(summary_of("explained"))
    assert explained.startswith("A steady current of 0.30 m/s flowing to 69 deg explains")
    assert "speed 0.301 +- 0.004 m/s, direction 69.0 +- 0.8 deg (flows to)" in explained
    assert "from 9.0 to 1.1 times the noise" in explained
    ambiguous = verdict_text(summary_of("ambiguous"))
    assert "but wind would do so nearly as well" in ambiguous.replace("\n", " ")
    assert "turning circle: separates current from wind" in ambiguous
    unexplained = verdict_text(summary_of("unexplained")).replace("\n", " ")
    assert "no effect in the catalogue describes" in unexplained and "sway" in unexplained
    consistent = verdict_text(summary_of("consistent"))
    assert consistent.startswith("The model agrees with the recordings")
    assert "what" not in consistent.split("\n\n")[-1].split()
    assert all(len(line) <= 88 for line in explained.splitlines() + ambiguous.splitlines())


def test_several_effects_and_effects_of_each_run():
    lag = CURRENT | {
        "name": "thrust-lag",
        "parameters": {"time_constant": {"value": 0.83, "std": 0.05, "unit": "s"}},
    }
    both = summary_of("explained") | {"effects": [CURRENT, lag]}
    text = " ".join(verdict_text(both).split())
    assert "flowing to 69 deg and actuators that lag with a time constant of 0.83 s" in text
    assert "together explain the mismatch" in text
    speeds = {
        name: {"speed": {"value": value, "std": 0.01, "unit": "m/s"}}
        for name, value in (("one", 0.21), ("two", 0.34))
    }
    own = [CURRENT | {"recording": name, "parameters": s} for name, s in speeds.items()]
    text = " ".join(verdict_text(summary_of("explained") | {"effects": own}).split())
    assert "of its own in each recording (speed 0.210 m/s to 0.340 m/s) explains" in text
    assert "current in two: speed 0.340 +- 0.010 m/s" in text


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_every_effect_has_a_phrase(name):
    effect = EFFECTS[name]
    values = effect.parameters(0.1 * np.ones(len(effect.sizes(usv()))))
    parameters = {
        key: {"value": float(value), "std": 0.01, "unit": effect.units[key]}
        for key, value in values.items()
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
        (5.0, math.nan, "s", "5.00 s"),
        (None, None, "s", "not known"),
        (9.99, 0.0996, "m", "10.0 +- 0.1 m"),
    ],
)
def test_rounding_with_error(value, std, unit, text):
    assert with_error(value, std, unit) == text


def test_rounding_alone():
    assert rounded(0.3012, 0.0042, "m/s") == "0.30 m/s"
    assert rounded(2.1, 0.01, "rad") == "120 deg" and rounded(2.15, 0.01, "rad") == "123 deg"
    assert rounded(1234.0, 30.0, "kg") == "1230 kg"
    assert significant(0.0, 3) == "0" and significant(1.3e-9, 2) == "1.3e-9"
    assert significant(12345678.0, 3) == "1.23e7" and significant(999.6, 3) == "1000"
    assert probability(1.3e-9) == "1e-9" and probability(0.0312) == "0.031"
    assert probability(0.0) == "< 1e-99" and probability(1.0) == "1.0"


def test_typesetting():
    assert typeset("69.0 +- 0.8 deg") == "69.0 ± 0.8°"
    assert typeset("p = 1e-9; N s^2/m^2") == "p = 1×10⁻⁹; N s²/m²"
    assert typeset("-3.2 -> 0.1 deg/s") == "−3.2 → 0.1°/s"
    assert typeset("zigzag-20 and run3e5") == "zigzag-20 and run3e5"
