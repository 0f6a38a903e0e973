"""Angles and rotations against numpy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffsea.kinematics import sine_and_cosine


@pytest.mark.parametrize("largest", [1.0, 100.0, 1e6])
def test_sine_and_cosine_are_numpys_to_the_last_bit(largest):
    angle = np.random.default_rng(0).uniform(-largest, largest, 20000)
    angle = np.concatenate([angle, np.arange(-8, 9) * np.pi / 4])
    sine, cosine = jax.jit(sine_and_cosine)(angle)
    np.testing.assert_allclose(sine, np.sin(angle), rtol=0, atol=3e-16)
    np.testing.assert_allclose(cosine, np.cos(angle), rtol=0, atol=3e-16)


def test_sine_and_cosine_have_each_other_for_derivatives_of_any_order():
    sine, cosine = (lambda a: sine_and_cosine(a)[0]), (lambda a: sine_and_cosine(a)[1])
    for angle in (0.0, 0.4, 2.0, -3.0, 40.0):
        assert jax.grad(sine)(angle) == pytest.approx(np.cos(angle), abs=1e-15)
        assert jax.jacfwd(cosine)(angle) == pytest.approx(-np.sin(angle), abs=1e-15)
        assert jax.hessian(sine)(angle) == pytest.approx(-np.sin(angle), abs=1e-15)


@pytest.mark.parametrize("largest", [3.0, 1e3])
def test_in_32_bits_sine_and_cosine_are_right_to_two_bits(largest):
    angle = np.random.default_rng(1).uniform(-largest, largest, 20_000).astype(np.float32)
    sine, cosine = jax.jit(sine_and_cosine)(angle)
    for found, known in ((sine, np.sin), (cosine, np.cos)):
        assert found.dtype == np.float32
        np.testing.assert_allclose(found, known(angle.astype(float)), atol=2.5e-7, rtol=0)


def test_sine_and_cosine_keep_32_bits_and_tell_what_is_no_angle():
    sine, cosine = sine_and_cosine(jnp.float32(0.5))
    assert isinstance(sine, jax.Array) and isinstance(cosine, jax.Array)
    assert sine.dtype == cosine.dtype == jnp.float32
    assert sine == pytest.approx(np.sin(0.5), abs=1e-7)
    assert np.isnan(np.asarray(sine_and_cosine(jnp.asarray(np.nan)))).all()
    assert np.isnan(np.asarray(sine_and_cosine(jnp.asarray(np.inf)))).all()
