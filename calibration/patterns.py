"""Radiation patterns: how much more or less is heard from each side of an antenna, chosen by BIC or by name.

Families: circle (no pattern), ellipse (range against heading is one), lobe (cos^2 with a floor, RWA eq 6),
fourier (orders 1 to 4), spline (periodic cubic, 6 to 12 knots). Orders stay low on purpose: a free high order
oscillates between the headings that were sampled. Gains are in dB and average zero over all headings.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from calibration import likelihood
from calibration.dataset import Readings
from calibration.fit import FitResult, Options, fit
from calibration.likelihood import Rows
from calibration.observations import make_rows
from fieldkit.errors import DataError
from fieldkit.messages import FloatArray

Family = Literal["circle", "ellipse", "lobe", "fourier", "spline"]
FAMILIES: tuple[Family, ...] = ("circle", "ellipse", "lobe", "fourier", "spline")
TABLE_STEP_DEG = 5.0
Gain = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, slots=True)
class Pattern:
    """A chosen pattern. `bic` has the best member of each family tried; the least wins."""

    family: Family
    name: str
    """With its order: fourier 2, spline 8."""
    parameters: int
    gain: Gain
    """Heading (deg, any shape) to gain in dB."""
    bic: dict[str, float]

    def table(self) -> tuple[FloatArray, FloatArray]:
        """Headings (deg, clockwise from the antenna's front) and gains (dB)."""
        heading = np.arange(0.0, 360.0, TABLE_STEP_DEG)
        return heading, self.gain(heading)


@dataclass(frozen=True, slots=True)
class _Candidate:
    family: Family
    name: str
    parameters: int
    gain: Gain
    nll: float


def fit_pattern(
    readings: Readings, options: Options | None = None, family: Family | Literal["auto"] = "auto"
) -> tuple[FitResult, Pattern]:
    """Choose a pattern and fit the rest with it. Intervals are those given the pattern.

    Raises `DataError` where the readings carry no headings or too few different ones.
    """
    options = options or Options()
    if readings.heading_deg is None:
        raise DataError(f"{readings.name}: a pattern needs the column heading_deg; there is none")
    sectors = len(np.unique(np.floor(readings.heading_deg % 360.0 / 30.0)))
    if sectors < 6:
        raise DataError(
            f"{readings.name}: headings fall in {sectors} of 12 sectors of 30 degrees; turn the "
            "antenna all round"
        )
    base = fit(readings, options)
    search = _Search(base, options.receiver_offsets)
    wanted = FAMILIES if family == "auto" else (family,)
    found = [candidate for name in wanted for candidate in search.family(name)]
    # Readings that share their place are counted as if each were new evidence: where the naive variances are
    # too small by a factor, the log-likelihood is too large by it.
    ratio = np.diag(base.covariance) / np.diag(base.naive_covariance)
    inflation = max(1.0, float(np.median(ratio[:2])))
    places = np.log(base.n_places)

    def bic(candidate: _Candidate) -> float:
        return 2.0 * candidate.nll / inflation + candidate.parameters * places

    best = min(found, key=bic)
    by_family: dict[str, float] = {}
    for candidate in sorted(found, key=bic):
        by_family.setdefault(candidate.family, float(bic(candidate)))
    gain = _centred(best.gain)
    result = fit(replace(readings, gain_db=gain(readings.heading_deg)), options)
    return result, Pattern(best.family, best.name, best.parameters, gain, by_family)


class _Search:
    """The distinct rows once, and the best member of each family on them."""

    def __init__(self, base: FitResult, receiver_offsets: bool) -> None:
        heading = np.asarray(base.readings.heading_deg)
        saturation = base.antenna.saturation_dbm
        self.rows = make_rows(
            base.readings, base.missed, base.censor_dbm, saturation, receiver_offsets, heading[:, None]
        )
        self.heading = self.rows.design[:, -1]
        self.matrix = self.rows.design[:, :-1]
        self.start = base.theta
        self.exponent = base.antenna.path_loss_exponent

    def family(self, name: Family) -> list[_Candidate]:
        if name == "circle":
            return [_Candidate(name, name, 0, _no_gain, self._nll(np.zeros_like(self.heading)))]
        if name == "fourier":
            return [self._linear(name, f"fourier {k}", _fourier(k)) for k in (1, 2, 3, 4)]
        if name == "spline":
            return [self._linear(name, f"spline {n}", _spline(n)) for n in (6, 8, 12)]
        if name == "ellipse":
            return [self._search(name, lambda p: _ellipse(self.exponent, *p), _ellipse_starts())]
        return [self._search(name, lambda p: _lobe(*p), _lobe_starts())]

    def _nll(self, offset_db: FloatArray, columns: FloatArray | None = None) -> float:
        return self._maximise(offset_db, columns)[1]

    def _maximise(self, offset_db: FloatArray, columns: FloatArray | None = None) -> tuple[FloatArray, float]:
        extra = np.empty((len(self.heading), 0)) if columns is None else columns
        r = self.rows
        rows = Rows(
            np.column_stack([self.matrix, extra]),
            r.low_dbm,
            r.high_dbm,
            r.count,
            r.place,
            r.offset_dbm + offset_db,
            r.seen_above_dbm,
        )
        start = np.concatenate([self.start[:-1], np.zeros(extra.shape[1]), self.start[-1:]])
        theta, converged = likelihood.maximise(rows, start)
        return theta, likelihood.nll(theta, rows) if converged else np.inf

    def _linear(self, family: Family, name: str, basis: Callable[[FloatArray], FloatArray]) -> _Candidate:
        columns = basis(self.heading)
        theta, value = self._maximise(np.zeros_like(self.heading), columns)
        weights = theta[self.matrix.shape[1] : -1]
        return _Candidate(family, name, columns.shape[1], lambda h: basis(h) @ weights, value)

    def _search(
        self, family: Family, gain_of: Callable[[FloatArray], Gain], starts: list[FloatArray]
    ) -> _Candidate:
        """Families that are not linear: the best of a coarse grid, then downhill from there."""
        from scipy.optimize import minimize

        def cost(p: FloatArray) -> float:
            return self._nll(gain_of(p)(self.heading))

        start = min(starts, key=cost)
        found = minimize(
            cost, start, method="Nelder-Mead", options={"xatol": 0.02, "fatol": 0.01, "maxfev": 200}
        )
        best = found.x if found.fun <= cost(start) else start
        return _Candidate(family, family, len(best), gain_of(best), float(min(found.fun, cost(start))))


def _no_gain(heading_deg: FloatArray) -> FloatArray:
    return np.zeros_like(np.asarray(heading_deg, dtype=float))


def _fourier(order: int) -> Callable[[FloatArray], FloatArray]:
    def basis(heading_deg: FloatArray) -> FloatArray:
        angle = np.radians(heading_deg)
        return np.stack([f(k * angle) for k in range(1, order + 1) for f in (np.cos, np.sin)], axis=-1)

    return basis


def _spline(knots: int) -> Callable[[FloatArray], FloatArray]:
    """Periodic cubic splines through `knots` even headings, one fewer than knots: they sum to zero."""

    def basis(heading_deg: FloatArray) -> FloatArray:
        from scipy.interpolate import CubicSpline

        at = np.linspace(0.0, 360.0, knots + 1)
        unit = np.vstack([np.eye(knots), np.eye(knots)[:1]])
        values = CubicSpline(at, unit, bc_type="periodic")(np.asarray(heading_deg) % 360.0)
        return values[..., :-1] - values[..., -1:]

    return basis


def _ellipse(exponent: float, log_ratio: float, front_deg: float) -> Gain:
    """Range is an ellipse round the antenna: exp(log_ratio) times as far ahead as to the side."""

    def gain(heading_deg: FloatArray) -> FloatArray:
        angle = np.radians(np.asarray(heading_deg) - front_deg)
        range2 = 1.0 / (np.cos(angle) ** 2 * np.exp(-2.0 * log_ratio) + np.sin(angle) ** 2)
        return 5.0 * exponent * np.log10(range2)

    return gain


def _lobe(front_deg: float, narrowness: float, floor_db: float) -> Gain:
    """20 log10 cos(narrowness * angle) within the lobe, never under the floor (RWA eq 6: narrowness 4)."""

    def gain(heading_deg: FloatArray) -> FloatArray:
        angle = np.radians((np.asarray(heading_deg) - front_deg + 180.0) % 360.0 - 180.0) * narrowness
        level = 20.0 * np.log10(np.maximum(np.cos(np.clip(angle, -np.pi / 2, np.pi / 2)), 1e-6))
        return np.maximum(level, -abs(floor_db))

    return gain


def _ellipse_starts() -> list[FloatArray]:
    return [np.array([ratio, front]) for ratio in (0.2, 0.6) for front in np.arange(0.0, 180.0, 22.5)]


def _lobe_starts() -> list[FloatArray]:
    return [
        np.array([front, narrow, floor])
        for front in np.arange(0.0, 360.0, 22.5)
        for narrow in (0.7, 1.5, 3.0)
        for floor in (6.0, 14.0)
    ]


def _centred(gain: Gain) -> Gain:
    mean = float(np.mean(gain(np.arange(0.0, 360.0, 1.0))))
    return lambda heading: gain(np.asarray(heading, dtype=float)) - mean
