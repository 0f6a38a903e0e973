"""Sobol sequences and indices: known variances, parts of a sequence, what is refused."""

import json
import math

import numpy as np
import pytest
from scipy.stats import qmc

import diffsea
from diffsea.cli import main
from diffsea.simulation import planning
from diffsea.simulation.designs import SobolSequence
from diffsea.studies import sobol


VESSEL = diffsea.read_vessel("otter").vessel
PLAN = planning.plan_trial(VESSEL, "zigzag")
RANGES = {name: (-math.pi, math.pi) for name in ("x_G", "N_r", "X_u")}


def ishigami(x):
    """The function of Ishigami and Homma (1990) with a = 7, b = 0.1."""
    return np.sin(x[:, 0]) + 7 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])


def test_indices_of_a_known_function_are_its_closed_form(monkeypatch):
    def numbers(vessel, plan, designs, progress):
        constant = np.full(len(designs.values), 3.0)
        gone = np.where(designs.values[:, 0] > 3, np.nan, 1.0)
        return {"known": ishigami(designs.values), "constant": constant, "gone": gone}

    monkeypatch.setattr(sobol, "_numbers", numbers)
    found = sobol.sobol_indices(VESSEL, PLAN, RANGES, 4096, seed=2)
    variance = 0.5 + 7**2 / 8 + 0.1 * math.pi**4 / 5 + 0.1**2 * math.pi**8 / 18
    first = [0.5 * (1 + 0.1 * math.pi**4 / 5) ** 2, 7**2 / 8, 0.0]
    both = 0.1**2 * math.pi**8 * (1 / 18 - 1 / 50)
    total = [first[0] + both, first[1], both]
    for k, name in enumerate(RANGES):
        assert found.first["known"][name].value == pytest.approx(first[k] / variance, abs=0.02)
        assert found.total["known"][name].value == pytest.approx(total[k] / variance, abs=0.02)
        for kind in (found.first, found.total):
            index = kind["known"][name]
            assert index.low <= index.value <= index.high and index.high - index.low < 0.1
    assert list(found.first) == ["known"] and found.left_out == ("gone",)
    assert found.designs == 4096 * 5


@pytest.mark.proof
def test_the_command_ranks_what_a_zigzag_depends_on(tmp_path, capsys):
    words = ["sensitivity", "otter", "--manoeuvre", "zigzag", "--sobol", "16"]
    ranges = ["mass=60:90", "N_r=-60:-20"]
    assert main([*words, *ranges, "--json", "-o", str(tmp_path)]) == 0
    told = json.loads((tmp_path / "sobol.json").read_text())
    capsys.readouterr()
    row = told["overshoot_1"]
    assert set(row) == {"mass", "N_r"} and set(row["mass"]) == {"first", "total"}
    assert row["N_r"]["total"]["value"] > row["mass"]["total"]["value"]
    page = (tmp_path / "sensitivity.html").read_text()
    assert "Sobol indices of" in page and "Share of each number&#39;s variance" in page


def test_parts_of_a_sequence_are_those_of_the_whole():
    space = SobolSequence({"mass": (60.0, 90.0), "N_r": (-60.0, -20.0)}, 64, seed=5)
    whole = space.rows(0, 64).values
    parts = [space.rows(begin, begin + 16).values for begin in range(0, 64, 16)]
    np.testing.assert_array_equal(np.concatenate(parts), whole)
    unit = (whole - [60.0, -60.0]) / [30.0, 40.0]
    known = qmc.Sobol(2, rng=np.random.default_rng(5)).random(64)
    np.testing.assert_allclose(unit, known, atol=1e-12)
    assert not np.array_equal(SobolSequence(space.axes, 64, seed=6).rows(0, 64).values, whole)


@pytest.mark.parametrize(
    ("words", "status", "told"),
    [
        (["--sobol", "100", "mass=60:90"], 1, "no power of two"),
        (["--sobol", "64"], 2, "give a number of designs"),
        (["--sobol", "64", "mass=90:60"], 1, "give the lower number first"),
        (["--sobol", "64", "masss=60:90"], 1, "did you mean 'mass'"),
        (["--sobol", "64", "mass=60:90", "--parameters", "mass"], 2, "leave --parameters out"),
    ],
)
def test_what_cannot_be_is_refused(words, status, told, tmp_path, capsys):
    command = ["sensitivity", "otter", "--manoeuvre", "zigzag", *words]
    assert main([*command, "-o", str(tmp_path / "out")]) == status
    assert told in capsys.readouterr().err and not (tmp_path / "out").exists()
