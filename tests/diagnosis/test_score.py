"""Efficient score tests and their joint null distribution against closed forms."""

import numpy as np
import pytest

from diffsea.diagnosis.score import Projection, joint_null
from diffsea.diagnosis.screening import mimicry


def test_independent_tests_are_corrected_as_sidak_does():
    tests = [slice(k, k + 1) for k in range(40)]
    null = joint_null(np.eye(40), tests, draws=20000)
    for p in (1e-3, 1e-2, 1e-6):
        assert null.family_wise(p) == pytest.approx(-np.expm1(40 * np.log1p(-p)), rel=0.15)
    assert null.family_wise(null.threshold) == pytest.approx(0.01, rel=0.2)


def test_tests_that_say_the_same_count_once():
    null = joint_null(np.ones((40, 40)), [slice(k, k + 1) for k in range(40)], draws=20000)
    for p in (0.05, 1e-4):
        assert null.family_wise(p) == pytest.approx(p, rel=0.15)


def test_a_block_of_columns_is_one_test_of_its_own_degrees_of_freedom():
    mixed = np.array([[1.0, 0.6, 0.0], [0.6, 1.0, 0.0], [0.0, 0.0, 1.0]])
    null = joint_null(mixed, [slice(0, 2), slice(2, 3)], draws=40000)
    assert null.family_wise(0.03) == pytest.approx(1 - 0.97**2, rel=0.1)


def test_score_has_its_size_under_white_noise_and_sees_a_shift():
    rng = np.random.default_rng(2)
    rows = 400
    columns = rng.normal(size=(6 * rows, 1))
    nuisance = rng.normal(size=(6 * rows, 3))
    run = np.zeros(rows, int)
    values = []
    for _ in range(400):
        projection = Projection(rng.normal(size=6 * rows), nuisance, run)
        values.append(projection.test(projection.efficient(columns)).p_value)
    assert np.mean(np.array(values) < 0.05) == pytest.approx(0.05, abs=0.035)
    shifted = Projection(rng.normal(size=6 * rows) - 0.3 * columns[:, 0], nuisance, run)
    score = shifted.test(shifted.efficient(columns))
    assert score.p_value < 1e-6
    assert score.step[0] == pytest.approx(0.3, abs=0.1)


def test_sizes_that_differ_between_parts_widen_the_error_of_their_mean():
    rng = np.random.default_rng(11)
    rows, parts = 4000, np.split(np.arange(4000), 40)
    uneven_parts = np.split(np.arange(4000), [100, 350])
    nuisance = np.zeros((6 * rows, 1))
    nuisance[:: 6 * rows] = 1.0
    columns = rng.normal(size=(6 * rows, 1))
    noise, run = rng.normal(size=6 * rows), np.zeros(rows, int)
    alone = Projection(noise, nuisance, run)
    assert alone.scatter(columns, parts) == pytest.approx(1.0, abs=0.5)
    assert alone.scatter(columns, uneven_parts) >= 1.0
    assert alone.scatter(columns, parts[:1]) == alone.scatter(0.0 * columns, parts) == 1.0
    sizes = 0.5 * rng.normal(size=40)
    assert np.std(sizes) > 0.3
    uneven = Projection(noise - columns[:, 0] * np.repeat(sizes, 600), nuisance, run)
    expected = 1 + 600 * np.var(sizes, ddof=1)  # each part has 600 values of unit information
    assert uneven.scatter(columns, parts) == pytest.approx(expected, rel=0.25)
    # One size in all parts is an effect, and no scatter of its size.
    steady = Projection(noise - 0.5 * columns[:, 0], nuisance, run)
    assert steady.scatter(columns, parts) == pytest.approx(1.0, abs=0.5)


def test_instances_for_runs_that_a_data_set_has_to_spare_are_no_degrees_of_freedom():
    rng = np.random.default_rng(5)
    rows, instances = 100, 4  # of which one belongs to a recording
    columns = np.zeros((6 * rows + instances + 2, instances))
    columns[: 6 * rows, 0] = rng.normal(size=6 * rows)
    columns[6 * rows + 2 :] = np.eye(instances) / 3
    nuisance = np.zeros((len(columns), 2))
    nuisance[: 6 * rows] = rng.normal(size=(6 * rows, 2))
    nuisance[6 * rows : 6 * rows + 2] = np.eye(2)
    residual = np.zeros(len(columns))
    residual[: 6 * rows] = rng.normal(size=6 * rows) - 0.2 * columns[: 6 * rows, 0]
    projection = Projection(residual, nuisance, np.zeros(rows, int))
    E = projection.efficient(columns)
    alone, all_of_them = projection.test(E[:, :1]), projection.test(E)
    assert all_of_them.p_value == pytest.approx(alone.p_value, rel=1e-9)
    assert all_of_them.step == pytest.approx([alone.step[0], 0, 0, 0])
    assert projection.test(E[:, 1:]).p_value == 1.0


def test_what_a_nuisance_can_do_is_not_counted():
    rng = np.random.default_rng(4)
    nuisance = rng.normal(size=(600, 2))
    run = np.zeros(100, int)
    projection = Projection(nuisance @ [5.0, -3.0] + rng.normal(size=600), nuisance, run)
    near = projection.efficient(nuisance[:, :1] + 1e-3 * rng.normal(size=(600, 1)))
    assert mimicry(near, projection.efficient(rng.normal(size=(600, 2)))) < 0.5
    assert projection.test(projection.efficient(rng.normal(size=(600, 1)))).p_value > 1e-3
