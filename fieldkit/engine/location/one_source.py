"""Where one source is, from all that was heard of it and from where nothing was."""

from dataclasses import dataclass, field

import numpy as np
from scipy.special import logsumexp, ndtr

from fieldkit.channel.model import Antenna
from fieldkit.channel.reml import min_range_m
from fieldkit.channel.spread import ChannelSpread, Draw, draws
from fieldkit.engine.likelihood.correlated import MOST_PLACES, log_likelihood, residuals, together
from fieldkit.engine.location.ground import FIRST_SIDE, Ground, Posterior, explore
from fieldkit.messages import FloatArray

DRAWS = 16
ROUGH_PLACES, ROUGH_SIDE = 120, 24
QUIET_ANYHOW = 1e-3
"""P(a place is silent, or not, for reasons that are not in the model)."""
_QUADRATURE = np.array([-1.7, -0.9, 0.0, 0.9, 1.7])
_WEIGHT = np.exp(-0.5 * _QUADRATURE**2) / np.exp(-0.5 * _QUADRATURE**2).sum()


@dataclass(frozen=True, slots=True, eq=False)
class Silence:
    """Places (k, 3) where a receiver listened this long (k,) and heard nothing of the source."""

    place_m: FloatArray
    duration_s: FloatArray


NO_SILENCE = Silence(np.zeros((0, 3)), np.zeros(0))


@dataclass(frozen=True, slots=True, eq=False)
class Radio:
    """What the receivers are known to hear."""

    antenna: Antenna
    spread: ChannelSpread
    power_sd_db: float = 0.0
    """Beyond how transmitters of the calibration differ."""
    power_levels_db: tuple[float, ...] = ()
    """Where somebody knows them; empty: unknown."""
    source_up_m: float = 0.0
    place_sigma_m: float = 0.0
    """Deviation of the receivers' positions."""
    ways: dict[int, list[list[Draw]]] = field(default_factory=dict)

    def draws(self, count: int) -> list[list[Draw]]:
        """For each known power (or the unknown one) that many ways the channel may be."""
        if count not in self.ways:
            found = draws(self.antenna, self.spread, count, self.power_sd_db)
            if self.power_levels_db:
                self.ways[count] = [
                    [_at_power(draw, level) for draw in found] for level in self.power_levels_db
                ]
            else:
                self.ways[count] = [found]
        return self.ways[count]


def _at_power(draw: Draw, power_db: float) -> Draw:
    mean = draw.mean.copy()
    mean[0] += power_db
    return Draw(draw.time_var, draw.place_var, draw.correlation_m, mean, draw.covariance)


@dataclass(frozen=True, slots=True, eq=False)
class OneSource:
    """Readings of one source: places (n, 3) and levels (n,). With them how long there was listened in the silence."""

    place_m: FloatArray
    level_db: FloatArray
    silence: Silence = NO_SILENCE
    rate_hz: float = 0.0
    """How often it is heard where it is well heard; 0: silence says nothing."""
    heard_at: Silence = NO_SILENCE
    """Where it was heard, and how long there was listened."""
    heard_level_db: FloatArray = field(default_factory=lambda: np.zeros(0))
    """(k,) mean level there."""
    heard_count: FloatArray = field(default_factory=lambda: np.zeros(0))
    """(k,) readings there."""


@dataclass(frozen=True, slots=True, eq=False)
class Located:
    """A source with its place."""

    posterior: Posterior
    fit: float
    """Mean square of the standardised residuals one step ahead: 1 where the channel model holds."""
    places: int
    """At how many places it was heard: the size of the sample, whatever the number of readings."""
    power_db: float
    """Against the calibrated transmitter."""


def locate(
    source: OneSource, radio: Radio, ground: Ground, count: int = DRAWS, *, roughly: bool = False
) -> Located:
    """The posterior of its place over the ground, and how well the model explains what was heard.

    `roughly`: for comparing hypotheses, with fewer places and cells and without the draws.
    """
    away = _distances(source, ground)
    least = min_range_m(away)
    count = 1 if roughly else count
    most = ROUGH_PLACES if roughly else MOST_PLACES
    places, neighbours = together(source.place_m, source.level_db, _cell_m(source, radio), most)
    ways = [draw for group in radio.draws(count) for draw in group]
    # Near a source an unsure position costs more decibels; the typical distance stands for all.
    smear = 4.343 * radio.antenna.path_loss_exponent * radio.place_sigma_m / max(float(np.median(away)), 1e-9)

    def log_of(points: FloatArray) -> tuple[FloatArray, FloatArray]:
        at = np.column_stack([points, np.full(points.shape[0], radio.source_up_m)])
        logs, coefficients = log_likelihood(at, places, neighbours, ways, least, smear)
        total = logsumexp(logs, axis=0) - np.log(len(ways))
        if source.rate_hz > 0.0 and source.heard_at.duration_s.size:
            total = total + _log_silent(at, coefficients, source, radio, ways[0], least)
        return total, coefficients

    posterior = explore(log_of, ground, ROUGH_SIDE if roughly else FIRST_SIDE)
    best = posterior.likeliest
    at = np.append(posterior.points_m[best], radio.source_up_m)
    off = residuals(at, places, neighbours, ways[0], least)
    return Located(
        posterior,
        float(np.mean(np.minimum(off**2, 12.0))),
        int(places.count.size),
        float(posterior.probability @ posterior.coefficients[:, 0]) - radio.antenna.power_at_1m_dbm,
    )


def _cell_m(source: OneSource, radio: Radio) -> float:
    """Readings nearer to each other than this are of one place: a small part of the correlation and of the path."""
    across = float(np.max(np.ptp(source.place_m[:, :2], axis=0), initial=0.0))
    return float(min(max(0.25 * radio.spread.correlation_m, 0.02 * across), 5.0)) or 0.01


def _distances(source: OneSource, ground: Ground) -> FloatArray:
    """Distances of the readings to where they were strongest: what is typical."""
    strongest = source.place_m[int(np.argmax(source.level_db))]
    away = np.sqrt(((source.place_m - strongest) ** 2).sum(axis=1))
    result: FloatArray = np.maximum(away, 0.01 * max(ground[2] - ground[0], ground[3] - ground[1]))
    return result


def _log_silent(
    at: FloatArray, coefficients: FloatArray, source: OneSource, radio: Radio, draw: Draw, least: float
) -> FloatArray:
    """(c,) log likelihood of how many packets were heard in all, its rate unknown: -n log exposure.

    A silent place is one witness however long it was silent: its exposure is -log E_S[exp(-rate p(S) T)] / rate over
    the shadowing S it may have. Where something was heard the shadowing is known as far as the readings determine it.
    So is n counted in places: packets of one place are no independent witnesses of how well others are heard.
    """
    heard, silent, rate_hz = source.heard_at, source.silence, source.rate_hz
    mean = _mean_level(at, coefficients, heard.place_m, least)
    white = draw.time_var + 1.0 / 12.0
    trust = draw.place_var / (draw.place_var + white / np.maximum(source.heard_count, 1.0))
    level = mean + trust * (source.heard_level_db - mean)
    deviation = np.sqrt(draw.place_var * (1.0 - trust) + white)
    exposure_s = ndtr((level - radio.antenna.threshold_dbm - 0.5) / deviation) @ heard.duration_s
    if silent.duration_s.size:
        mean = _mean_level(at, coefficients, silent.place_m, least)
        quiet = np.zeros(mean.shape)
        for deviate, weight in zip(_QUADRATURE, _WEIGHT, strict=True):
            level = mean + deviate * np.sqrt(draw.place_var) - radio.antenna.threshold_dbm - 0.5
            quiet += weight * np.exp(-rate_hz * silent.duration_s * ndtr(level / np.sqrt(white)))
        exposure_s = exposure_s - np.log(quiet + QUIET_ANYHOW).sum(axis=1) / rate_hz
    return np.asarray(-heard.duration_s.size * np.log(exposure_s + 1.0 / rate_hz))


def _mean_level(at: FloatArray, coefficients: FloatArray, place_m: FloatArray, least: float) -> FloatArray:
    """(c, k) mean level at each place of a source at each point with the coefficients found for it."""
    total = np.empty((at.shape[0], place_m.shape[0]))
    for begin in range(0, at.shape[0], 256):
        part = slice(begin, begin + 256)
        offset = place_m[None] - at[part, None, :]
        away = np.maximum(np.sqrt((offset**2).sum(axis=-1)), least)
        own = coefficients[part]
        total[part] = (
            own[:, :1]
            - 10.0 * np.maximum(own[:, 1:2], 0.5) * np.log10(away)
            + own[:, 2:3] * offset[..., 0] / away
            + own[:, 3:4] * offset[..., 1] / away
        )
    return total
