"""Runs side by side against one loop along all rows."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffsea.identification.data import batching


LENGTHS = {"one": [40], "even": [30, 30, 30, 30], "uneven": [60, 7, 31, 50, 12, 55, 64, 3, 18, 40]}
SPARE = 9


def dataset(lengths):
    """The run of every used row, where runs start, and an input for every row."""
    run = np.repeat(np.arange(len(lengths)), lengths)
    starts = np.zeros(len(run) + SPARE, bool)
    starts[np.cumsum([0, *lengths[:-1]])] = True
    inputs = np.random.default_rng(0).normal(size=len(run) + SPARE)
    inputs[len(run) :] = 0.0
    return run, starts, inputs


def remembered(state, row):
    """A first-order lag that begins anew where a run starts."""
    start, value = row
    state = jnp.where(start, value, 0.7 * state + value)
    return state, (state, jnp.stack([state, value]))


@pytest.mark.parametrize("lengths", LENGTHS.values(), ids=LENGTHS)
@pytest.mark.parametrize("least", [(0, 0), (300, 3)])
def test_lanes_give_every_row_what_one_loop_gives(lengths, least):
    run, starts, inputs = dataset(lengths)
    found = batching.batch_layout(run, len(starts), least)
    rows = jnp.asarray(starts), jnp.asarray(inputs)
    alone = jax.lax.scan(remembered, jnp.zeros(()), rows)[1]
    beside = batching.batched_scan(remembered, jnp.zeros(()), rows, found)
    for a, b in zip(alone, beside, strict=True):
        np.testing.assert_allclose(b[: len(run)], a[: len(run)], rtol=1e-14)


@pytest.mark.parametrize("lengths", LENGTHS.values(), ids=LENGTHS)
def test_a_spare_row_is_found_where_nothing_is(lengths):
    run, starts, _ = dataset(lengths)
    found = batching.batch_layout(run, len(starts))
    held = np.asarray(found.rows).ravel()[np.asarray(found.place)]
    np.testing.assert_array_equal(held[: len(run)], np.arange(len(run)))
    assert np.all(held[len(run) :] >= len(run))


def test_lanes_of_one_shape_are_had_by_asking():
    few, many = dataset([50, 20])[0], dataset([40, 40, 40, 40])[0]
    shape = batching.batch_layout(many, len(many) + 1).shape
    assert batching.batch_layout(few, len(few) + 1, shape).shape == shape


def test_even_runs_lie_side_by_side_and_a_long_one_is_not_waited_for():
    even = batching.batch_layout(np.repeat(np.arange(6), 500), 3001)
    assert even.shape[1] == 6 and even.shape[0] < 600
    uneven = batching.batch_layout(np.repeat(np.arange(5), [2000, 100, 100, 100, 100]), 2401)
    assert uneven.shape[1] == 1
