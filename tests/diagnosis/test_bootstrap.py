"""What simulated and refitted data sets say of chance."""

import io
from types import SimpleNamespace

import numpy as np
import pytest

from diffsea.cli.progress import StagedProgress
from diffsea.diagnosis import bootstrap as module
from diffsea.diagnosis.bootstrap import NONE, Bootstrap, bootstrap
from diffsea.diagnosis.search import diagnose
from diffsea.errors import UserError


def dataset(value: float) -> SimpleNamespace:
    return SimpleNamespace(dataset=SimpleNamespace(measured=np.full((3, 6), value)))


@pytest.fixture
def screened(monkeypatch):
    """Data sets numbered from one, the screening of each with p-values 1/n and 1/sqrt(n)."""
    count = iter(range(1, 10**6))
    nominal = SimpleNamespace(free=(), coordinates=np.zeros(1), noise=None)
    monkeypatch.setattr(module, "resimulate", lambda *_: dataset(next(count)))
    monkeypatch.setattr(module, "estimate", lambda made, *_: made.dataset.measured[0, 0])
    monkeypatch.setattr(
        module, "screen",
        lambda made, n: SimpleNamespace(p_value=1 / n, remainder=1 / np.sqrt(n)),
    )  # fmt: skip
    return lambda draws, told=lambda text: None: bootstrap(None, nominal, draws, told)


def test_a_p_value_is_its_rank_among_the_draws():
    drawn = Bootstrap(np.arange(1, 100) / 100, np.full(99, 0.2))
    assert drawn.of_strongest(0.0) == pytest.approx(0.01)
    assert drawn.of_strongest(0.105) == pytest.approx(0.11)
    assert drawn.of_strongest(1.0) == 1.0
    assert drawn.of_located(0.19) == pytest.approx(0.01)
    assert drawn.of_located(0.2) == 1.0


def test_without_draws_a_p_value_stands():
    assert (NONE.draws, NONE.of_strongest(0.03), NONE.of_located(0.4)) == (0, 0.03, 0.4)


def test_every_data_set_is_fitted_and_screened(screened):
    said = []
    drawn = screened(100, said.append)
    assert drawn.strongest == pytest.approx(1 / np.arange(100.0, 0, -1))
    assert drawn.located == pytest.approx(1 / np.sqrt(np.arange(100.0, 0, -1)))
    assert said[0] == "simulating 1 of 100 data sets" and len(said) == 100


def test_too_few_draws_are_refused(screened):
    with pytest.raises(UserError, match="99 bootstrap draws.*take 100"):
        screened(99)


@pytest.mark.parametrize(("every", "refused"), [(20, False), (5, True)])
def test_others_are_drawn_for_those_that_diverge(screened, monkeypatch, every, refused):
    count = iter(range(1, 10**6))
    broken = lambda *_: dataset(np.nan if (n := next(count)) % every == 0 else n)
    monkeypatch.setattr(module, "resimulate", broken)
    if refused:
        with pytest.raises(UserError, match="11 of 55 runs.*diverge"):
            screened(100)
    else:
        assert screened(100).draws == 100


def test_too_few_draws_are_refused_before_anything_is_fitted():
    with pytest.raises(UserError, match="5 bootstrap draws"):
        diagnose(None, [], draws=5)


def test_data_sets_are_one_stage_of_the_progress(screened):
    said = io.StringIO()
    screened(100, StagedProgress(4, said))
    assert said.getvalue().count("\n") == 1 and "simulating 100 data sets" in said.getvalue()
