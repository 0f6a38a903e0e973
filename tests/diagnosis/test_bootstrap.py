"""What simulated and refitted data sets say of chance."""

import dataclasses
import io

import equinox as eqx
import numpy as np
import pytest
from tests.diagnosis.small import DOCUMENT, still_problem, usv
from tests.runs import random_steps

from diffsea import EFFECTS, UserError
from diffsea.cli.progress.staged import StagedProgress
from diffsea.diagnosis.bootstrap import (
    BOOTSTRAP_SEED,
    NO_BOOTSTRAP,
    Bootstrap,
    bootstrap,
    finite_draws,
)
from diffsea.diagnosis.screening import screen
from diffsea.diagnosis.verdict import diagnose
from diffsea.identification.fit import Start, estimate
from diffsea.identification.problem import make_problem
from diffsea.identification.resimulation import resimulate


pytestmark = pytest.mark.slow


FREE = ("X_u", "N_r")


def test_a_p_value_is_its_rank_among_the_draws():
    drawn = Bootstrap(np.arange(1, 100) / 100, np.full(99, 0.2))
    assert drawn.of_strongest(0.0) == pytest.approx(0.01)
    assert drawn.of_strongest(0.105) == pytest.approx(0.11)
    assert drawn.of_strongest(1.0) == 1.0
    assert drawn.of_located(0.19) == pytest.approx(0.01)
    assert drawn.of_located(0.2) == 1.0


def test_without_draws_a_p_value_stands():
    assert NO_BOOTSTRAP.draws == 0
    assert (NO_BOOTSTRAP.of_strongest(0.03), NO_BOOTSTRAP.of_located(0.4)) == (0.03, 0.4)


@pytest.fixture(scope="module")
def problem():
    run = random_steps(DOCUMENT, 7, 40.0, 0.5)
    return make_problem(usv(), [run], FREE, (EFFECTS["gyro-bias"],))


@pytest.mark.proof
def test_every_data_set_is_fitted_and_screened(problem):
    nominal, said = estimate(problem, FREE), []
    drawn = bootstrap(problem, nominal, 5, said.append)
    assert said == [f"simulating {k} of 5 data sets" for k in range(1, 6)]
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    screenings = []
    for _ in range(5):
        another = resimulate(problem, nominal, rng)
        fitted = estimate(another, FREE, Start.of_other_data(nominal))
        screenings.append(screen(another, fitted))
    assert drawn.strongest.tolist() == sorted(one.p_value for one in screenings)
    assert drawn.located.tolist() == sorted(one.located_p_value for one in screenings)
    assert len(set(drawn.strongest)) == 5


@pytest.mark.proof
def test_data_sets_are_one_stage_of_the_progress(problem):
    said = io.StringIO()
    bootstrap(problem, estimate(problem, FREE), 2, StagedProgress(4, said))
    assert said.getvalue().count("\n") == 1 and "simulating 2 data sets" in said.getvalue()


def data_sets(every: int):
    """Endless data sets of which each so many-th diverged."""
    sound = still_problem()
    broken = eqx.tree_at(lambda data: data.measured, sound.dataset, sound.dataset.measured * np.nan)
    number = 0
    while True:
        number += 1
        yield dataclasses.replace(sound, dataset=broken) if number % every == 0 else sound


def test_others_are_drawn_for_those_that_diverge():
    drawn = list(finite_draws(data_sets(every=20), 100))
    assert len(drawn) == 100
    assert all(np.isfinite(np.asarray(one.dataset.measured)).all() for one in drawn)


def test_a_model_of_which_simulations_diverge_says_nothing_of_chance():
    with pytest.raises(UserError, match="11 of 55 runs.*diverge.*--bootstrap"):
        list(finite_draws(data_sets(every=5), 100))


def test_too_few_draws_are_refused_before_anything_is_fitted():
    with pytest.raises(UserError, match="99 bootstrap draws.*take 100"):
        diagnose(usv(), [], draws=99)
