"""Draws of a prior are the matrix product, and a row's bytes depend on no other row."""

import numpy as np

from anchorflow_trajectory.ode.integrate import drawn


def test_draws_are_the_product_row_by_row() -> None:
    rng = np.random.default_rng(0)
    noise, basis = (rng.normal(size=shape).astype(np.float32) for shape in ((70, 27), (27, 448)))
    draws = drawn(noise, basis)
    expected = noise.astype(np.float64) @ basis.astype(np.float64)
    np.testing.assert_allclose(draws, expected, atol=1e-5, rtol=0)
    np.testing.assert_array_equal(drawn(noise[5:6], basis), draws[5:6])
