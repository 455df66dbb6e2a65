"""The tableau, digit by digit against scipy's, and by its own order conditions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import DOP853

from dynamics.motions import dormand_prince as own


def test_every_number_is_scipys() -> None:
    assert np.array_equal(own.STEPS, DOP853.A)
    assert np.array_equal(own.DENSE_STEPS[12, :12], DOP853.B)
    assert np.array_equal(own.DENSE_STEPS[13:], DOP853.A_EXTRA)
    assert np.array_equal(own.DENSE_NODES, np.r_[DOP853.C, 1.0, DOP853.C_EXTRA])
    assert np.array_equal(own.WEIGHTS, DOP853.B)
    assert np.array_equal(own.ERROR_3, DOP853.E3)
    assert np.array_equal(own.ERROR_5, DOP853.E5)
    assert np.array_equal(own.INTERPOLANT, DOP853.D)


@pytest.mark.parametrize("power", range(1, 9))
def test_the_weights_integrate_powers_to_order_eight(power: int) -> None:
    assert own.WEIGHTS @ own.NODES ** (power - 1) == pytest.approx(1 / power, abs=1e-14)
