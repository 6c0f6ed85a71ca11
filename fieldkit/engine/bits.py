"""Numbers as their bits, for compiled loops: a table's index, and a logarithm that a compiler can vectorise."""

import math
from typing import Any

import numpy as np
from numba import types
from numba.extending import intrinsic

from fieldkit.engine.compiled import njit

_MANTISSA = np.uint64(2**52 - 1)
_ONE = np.uint64(1023 << 52)
_LOG_2 = math.log(2.0)
_SQRT_2 = math.sqrt(2.0)


def _cast(_typing_context: Any, number: Any) -> Any:
    """A float64 as its 64 bits (sign, exponent, leading digits first), and back."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(arguments[0], context.get_value_type(signature.return_type))

    return (types.uint64 if number == types.float64 else types.float64)(number), generate


bits_of: Any = intrinsic(_cast)
"""float64 to uint64, or uint64 to float64, bit by bit."""


@njit(cache=True, nogil=True, inline="always")
def fast_log(x: float) -> float:
    """Natural logarithm of a normal positive number, right to 4e-11.

    The digits' part is 2 artanh(s) with s = (m - sqrt 2) / (m + sqrt 2), by its series: |s| < 0.172.
    """
    bits = bits_of(x)
    m = bits_of((bits & _MANTISSA) | _ONE)
    exponent = np.float64(np.int32(bits >> np.uint64(52))) - 1022.5
    s = (m - _SQRT_2) / (m + _SQRT_2)
    s2 = s * s
    tail = s2 * (1.0 / 3.0 + s2 * (1.0 / 5.0 + s2 * (1.0 / 7.0 + s2 * (1.0 / 9.0 + s2 * (1.0 / 11.0)))))
    result: float = exponent * _LOG_2 + 2.0 * (s + s * tail)
    return result
