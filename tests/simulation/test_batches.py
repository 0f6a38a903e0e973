"""How many designs run side by side."""

import pytest

from diffsea.simulation import batches


@pytest.mark.parametrize(("rows", "size"), [(1, 1), (3, 4), (64, 64), (65, 64), (10**6, 64)])
def test_on_processors_batches_stay_in_the_cache(monkeypatch, rows, size):
    monkeypatch.setattr(batches, "_on_processors", lambda: True)
    for steps in (10, 10**6):
        assert batches.batch_size(rows, steps) == size


@pytest.mark.parametrize(
    ("rows", "steps", "size"),
    [
        (10, 100, 16),
        (10**6, 100, 4096),  # 105 MB
        (10**6, 2000, 4096),  # 2.1 GB, the most
        (10**6, 2100, 2048),
        (10**6, 25_000, 256),
        (10**6, 10**7, 64),  # no less than on processors
    ],
)
def test_on_a_gpu_long_trials_run_fewer_at_a_time(monkeypatch, rows, steps, size):
    monkeypatch.setattr(batches, "_on_processors", lambda: False)
    assert batches.batch_size(rows, steps) == size
