"""The vectorised logarithm against the library's, over every exponent a probability can have."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numba import njit

from fieldkit.engine.bits import fast_log

compiled = njit(lambda x: fast_log(x))


@given(st.floats(1e-300, 1e300))
def test_the_fast_logarithm_is_right_to_4e_11(x: float) -> None:
    assert compiled(x) == pytest.approx(np.log(x), abs=4e-11, rel=1e-14)


@pytest.mark.parametrize("x", [1.0, 2.0, 0.5, 1.0 - 2.0**-53, 1.0 + 2.0**-52, np.sqrt(2.0), 1e-300])
def test_also_where_exponent_or_digits_turn_over(x: float) -> None:
    assert compiled(x) == pytest.approx(np.log(x), abs=4e-11)
