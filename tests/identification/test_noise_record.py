"""The noise of fit.json is read as it was written; what a fit did not have is as expected."""

import json

import numpy as np
import pytest

from diffsea.identification.filter.covariance import Noise
from diffsea.identification.filter.noise_record import noise_of_record, noise_record


NOISE, GUESS = Noise.of(np.linspace(-3.0, 2.0, 16)), Noise.of(np.full(16, -1.0))
EVERYTHING = np.ones(6, bool)


def test_what_is_written_is_read():
    record = json.loads(json.dumps(noise_record(NOISE, EVERYTHING)))
    assert list(record["sensor"]) == ["x", "y", "psi", "u", "v", "r"]
    assert record["gust_memory"]["v"] == pytest.approx(np.exp(NOISE.memory[1]))
    np.testing.assert_allclose(noise_of_record(record, GUESS).scales, NOISE.scales, rtol=1e-12)


def test_sensors_that_measured_nothing_and_a_walk_without_fixes_are_as_expected():
    record = noise_record(NOISE, np.array([False, False, True, True, False, True]))
    assert list(record["sensor"]) == ["psi", "u", "r"] and record["position_walk"] == {}
    old = {kind: scales for kind, scales in record.items() if kind != "position_walk"}
    for told in (record, old):
        found = noise_of_record(told, GUESS)
        np.testing.assert_allclose(np.asarray(found.sensor)[[0, 1, 4]], -1.0)
        np.testing.assert_allclose(*(np.asarray(one.sensor)[[2, 3, 5]] for one in (found, NOISE)))
        assert float(found.walk[0]) == pytest.approx(-1.0)
    with pytest.raises(KeyError):
        noise_of_record({"gust": {}}, GUESS)
