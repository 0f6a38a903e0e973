# pyright: reportArgumentType=false
"""Fits that are kept until the work that they belong to has ended."""

import dataclasses

import numpy as np
import pytest
from tests.diagnosis.small import still_problem

import diffsea
from diffsea.budget import on_every_core, time_budget
from diffsea.identification import fit, kept_fits
from diffsea.identification.estimates import FitOutcome
from diffsea.identification.fit import Start, estimate
from diffsea.identification.kept_fits import fits_kept
from diffsea.progress import PartialProgress


FREE = ("X_u", "N_r")


@pytest.fixture(scope="module")
def problem():
    return still_problem("gyro-bias")


@pytest.fixture
def calls(monkeypatch):
    """Starts of the fits that were made anew."""
    made, search = [], fit._search
    note = lambda problem, free, start, *rest: (
        made.append(start),
        search(problem, free, start, *rest),
    )[1]
    monkeypatch.setattr(fit, "_search", note)
    return made


def same(one, other):
    """Whether two fits are alike to the last bit."""
    pairs = [
        (getattr(one, field.name), getattr(other, field.name))
        for field in dataclasses.fields(one)
        if field.name not in ("state", "_filter_runs")
    ]
    pairs.append((np.asarray(one.noise.scales), np.asarray(other.noise.scales)))
    return all(np.array_equal(a, b) and type(a) is type(b) for a, b in pairs)


def interrupted(problem, folder, **options):
    """A fit in work that is then interrupted, and what it said."""
    said = []
    with pytest.raises(KeyboardInterrupt), fits_kept(folder):
        found = estimate(problem, FREE, progress=said.append, **options)
        raise KeyboardInterrupt
    return found, said


def test_a_fit_that_is_asked_for_twice_is_none_of_earlier_work(problem, calls, tmp_path):
    told = []
    with fits_kept(tmp_path / "parts", told.append) as kept:
        first = estimate(problem, FREE)
        second = estimate(problem, FREE)
    assert len(calls) == 1 and same(first, second) and kept.found == 0 and told == []


def test_a_fit_of_interrupted_work_is_taken_from_there_to_the_last_bit(problem, calls, tmp_path):
    folder, again, told = tmp_path / "parts", [], []
    first, said = interrupted(problem, folder)
    assert len(list(folder.iterdir())) == 1 and len(calls) == 1
    with fits_kept(folder, told.append) as kept:
        other = still_problem("gyro-bias")  # the same, made anew
        second = estimate(other, FREE, progress=again.append)
        estimate(other, FREE)
    assert len(calls) == 1 and kept.found == 2 and len(told) == 1 and str(folder) in told[0]
    assert same(first, second)
    assert again == said and [type(one) for one in again] == [type(one) for one in said]
    shares = [one.share for one in said if isinstance(one, PartialProgress)]
    assert shares and shares == [one.share for one in again if isinstance(one, PartialProgress)]
    run, kept_run = first.filter_run(problem), second.filter_run(problem)
    np.testing.assert_array_equal(run.white, kept_run.white)


def test_a_fit_by_other_source_is_made_anew(problem, calls, tmp_path, monkeypatch):
    """The same version of the package, and one letter more in one of its files."""
    package = tmp_path / "diffsea"
    package.mkdir()
    for name in ("__init__.py", "fit.py"):
        (package / name).write_text("a = 1\n")
    monkeypatch.setattr(diffsea, "__file__", str(package / "__init__.py"))
    monkeypatch.setattr(kept_fits, "_source_digest", kept_fits._source_digest.__wrapped__)
    folder = tmp_path / "parts"
    interrupted(problem, folder)
    interrupted(problem, folder)
    assert len(calls) == 1
    (package / "fit.py").write_text("a = 2\n")
    interrupted(problem, folder)
    assert len(calls) == 2


def test_another_fit_is_made_anew(problem, calls, tmp_path):
    interrupted(problem, tmp_path)
    moved = problem.dataset.measured.at[5, 3].add(1e-12)
    data = dataclasses.replace(problem.dataset, measured=moved)
    heavier = dataclasses.replace(problem.base, rigid_body=dataclasses.replace(
        problem.base.rigid_body, mass=problem.base.rigid_body.mass * (1 + 1e-12)))  # fmt: skip
    priors = tuple(dataclasses.replace(one, spread=0.9) for one in problem.layout.parameters)
    mean, noise = problem.start()
    start = np.full(problem.layout.size, 1e-9)
    with fits_kept(tmp_path):
        estimate(dataclasses.replace(problem, dataset=data), FREE, rounds=1)
        estimate(dataclasses.replace(problem, base=heavier), FREE, rounds=1)
        layout = dataclasses.replace(problem.layout, parameters=priors)
        estimate(dataclasses.replace(problem, layout=layout), FREE, rounds=1)
        estimate(problem, FREE[:1], rounds=1)
        estimate(problem, FREE, Start(start), rounds=1)
        estimate(problem, FREE, Start(mean, noise), rounds=1)
        estimate(problem, FREE, Start(mean, noise, start), rounds=1)
        estimate(problem, FREE, rounds=1)
        estimate(problem, FREE, rounds=1, fixed_noise=True)
        assert len(calls) == 10
        estimate(problem, FREE, rounds=1)
        assert len(calls) == 10


def test_work_that_ends_or_fails_leaves_nothing_and_what_others_put_there(problem, tmp_path):
    folder = tmp_path / "parts"
    with fits_kept(folder):
        estimate(problem, FREE, rounds=1)
        assert folder.exists()
    assert not folder.exists()
    with pytest.raises(ValueError), fits_kept(folder):
        estimate(problem, FREE, rounds=1)
        raise ValueError
    assert not folder.exists()
    folder.mkdir()
    (folder / "mine.txt").write_text("kept")
    with fits_kept(folder):
        estimate(problem, FREE, rounds=1)
    assert [one.name for one in folder.iterdir()] == ["mine.txt"]


@pytest.mark.parametrize(
    "damage", [lambda whole: b"", lambda whole: whole[:-200], lambda whole: b"PK" * 300]
)
def test_a_file_that_is_damaged_is_no_fit(damage, problem, calls, tmp_path):
    first, _ = interrupted(problem, tmp_path)
    (file,) = tmp_path.iterdir()
    file.write_bytes(damage(file.read_bytes()))
    second, _ = interrupted(problem, tmp_path)
    assert len(calls) == 2 and same(first, second)
    interrupted(problem, tmp_path)
    assert len(calls) == 2  # it was written again


def test_a_fit_that_had_no_time_is_not_kept(problem, tmp_path):
    with fits_kept(tmp_path), time_budget(-1.0):
        assert estimate(problem, FREE).outcome is FitOutcome.OUT_OF_TIME
        assert not list(tmp_path.iterdir())


def test_where_nothing_can_be_written_that_is_told_once_and_fits_go_on(problem, calls, tmp_path):
    (tmp_path / "parts").write_text("a file")
    told = []
    with fits_kept(tmp_path / "parts", told.append):
        estimate(problem, FREE, rounds=1)
        estimate(problem, FREE, rounds=2)
    assert len(calls) == 2 and len(told) == 1
    assert "not kept" in told[0] and str(tmp_path / "parts") in told[0]


def test_threads_of_the_work_keep_their_fits_and_others_keep_none(problem, tmp_path):
    with pytest.raises(KeyboardInterrupt), fits_kept(tmp_path):
        on_every_core(lambda rounds: estimate(problem, FREE, rounds=rounds), (1, 2))
        raise KeyboardInterrupt
    assert len(list(tmp_path.iterdir())) == 2
    estimate(problem, FREE, rounds=3)
    assert len(list(tmp_path.iterdir())) == 2
