"""The compiled hot loop of the CSMA particle filter. Its plain numpy twin is in the tests."""

import math

import numpy as np

from fieldkit.engine.compiled import njit
from fieldkit.messages import FloatArray


@njit(cache=True, nogil=True)
def _cdf(y: float, z_i: float, z_j: float) -> float:
    """CSMA-PF eq 8."""
    cosine = (y - z_i - z_j) / (2.0 * math.sqrt(z_i * z_j))
    if cosine <= -1.0:
        return 0.0
    if cosine >= 1.0:
        return 1.0
    return 1.0 - math.acos(cosine) / math.pi


@njit(cache=True, nogil=True)
def reading_likelihood(
    particles: FloatArray,
    robot: FloatArray,
    scale: float,
    exponent: float,
    gain: FloatArray,
    z: float,
    p: float,
    q: float,
    sigma_db: float,
    nearest: float,
    out: FloatArray,
) -> None:
    """out (n,): p(reading z | particle), CSMA-PF eq 10, for particles (n, m, 2) of m sources each.

    `robot` (3,) is x, y and heading (counter-clockwise from x); `gain` holds the antenna's linear gain at evenly
    spaced angles counter-clockwise off its front, linear in dB in between. A single source gives a Gaussian in dB of
    `sigma_db` (a density over linear z), or eq 4's indicator where that is 0; a pair gives eq 9. Ranges under
    `nearest` are clamped.
    """
    n, m = particles.shape[0], particles.shape[1]
    k = gain.shape[0]
    strength = np.empty(m)
    amplitude = np.empty(m)
    log_z = math.log(z) if z > 0.0 else -1e9
    log_gain = np.log(np.maximum(gain, 1e-12) * scale)
    sigma = max(sigma_db, 1e-9) * math.log(10.0) / 10.0
    height = (
        p / (sigma_db * math.sqrt(2.0 * math.pi)) * 10.0 / (z * math.log(10.0)) if sigma_db > 0.0 else 0.0
    )
    for i in range(n):
        total = 0.0
        for s in range(m):
            dx = particles[i, s, 0] - robot[0]
            dy = particles[i, s, 1] - robot[1]
            r2 = max(dx * dx + dy * dy, nearest * nearest)
            turn = ((math.atan2(dy, dx) - robot[2]) / (2.0 * math.pi)) % 1.0 * k
            index = int(turn) % k
            share = turn - int(turn)
            gained = log_gain[index] + share * (log_gain[(index + 1) % k] - log_gain[index])
            mean = gained - 0.5 * exponent * math.log(r2)
            amplitude[s] = math.exp(0.5 * mean)
            strength[s] = amplitude[s] * amplitude[s]
            if sigma_db > 0.0:
                t = (log_z - mean) / sigma
                if t * t < 1400.0:
                    total += height * math.exp(-0.5 * t * t)
            elif math.floor(strength[s] + 0.5) == z:
                total += p
        if q > 0.0:
            for s in range(m):
                for u in range(s + 1, m):
                    both = strength[s] + strength[u]
                    spread = 2.0 * amplitude[s] * amplitude[u]
                    if z + 0.5 > both - spread and z - 0.5 < both + spread:
                        total += q * (
                            _cdf(z + 0.5, strength[s], strength[u]) - _cdf(z - 0.5, strength[s], strength[u])
                        )
        out[i] = total
