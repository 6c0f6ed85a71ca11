"""Radiation patterns: how much more or less is heard from each side of an antenna, chosen by BIC or by name.

circle: no pattern. ellipse: range against heading is one. lobe: cos^2 with a floor (RWA eq 6). dipole: |cos|,
weaker behind (CSMA-PF eq 3). fourier: orders 1 to 4. spline: periodic cubic, smoothed. Gains are in dB and
average zero over all headings. Intervals of all parameters are widened by what is not known of the pattern.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from calibration import families, likelihood
from calibration.dataset import Readings
from calibration.families import FAMILIES, SHAPE_OF, Basis, Family, Gain
from calibration.fit import FitResult, Options, fit, intervals, offsets_of
from calibration.likelihood import Rows
from calibration.observations import make_rows
from calibration.spread import clustered
from fieldkit.channel.antenna_file import SHAPES
from fieldkit.errors import DataError
from fieldkit.messages import FloatArray

TABLE_STEP_DEG = 5.0
ALL_ROUND = np.arange(0.0, 360.0, 1.0)


@dataclass(frozen=True, slots=True)
class Pattern:
    """A chosen pattern. `bic` has the best member of each family tried; the least wins."""

    family: Family
    name: str
    """With its order: fourier 2."""
    parameters: float
    """How many, effectively: a smoothed spline has fewer than knots."""
    gain: Gain
    gain_sigma: Gain
    """Heading to the standard error of its gain in dB, clustered by place, the family taken as right."""
    bic: dict[str, float]
    shape: dict[str, float] = field(default_factory=dict)
    """For lobe and dipole: what `fieldkit.channel.pattern` needs."""

    def table(self) -> tuple[FloatArray, FloatArray]:
        """Headings (deg, clockwise from the antenna's front) and gains (dB)."""
        heading = np.arange(0.0, 360.0, TABLE_STEP_DEG)
        return heading, self.gain(heading)


@dataclass(frozen=True, slots=True)
class _Candidate:
    family: Family
    name: str
    parameters: float
    gain: Gain
    nll: float
    slope: Basis
    """Heading (n,) to the gain's derivative by each parameter (n, k)."""
    penalty: FloatArray
    """(k, k)."""
    values: FloatArray


def fit_pattern(
    readings: Readings, options: Options | None = None, family: Family | Literal["auto"] = "auto"
) -> tuple[FitResult, Pattern]:
    """Choose a pattern and fit the rest with it. That another family may be right is not in the intervals.

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
    search = _Search(fit(readings, options), options.receiver_offsets)
    wanted = FAMILIES if family == "auto" else (family,)
    found = sorted(
        (candidate for name in wanted for candidate in search.family(name)),
        key=lambda candidate: search.bic(candidate),
    )
    best = found[0]
    by_family: dict[str, float] = {c.family: float(search.bic(c)) for c in reversed(found)}
    offset = -float(np.mean(best.gain(ALL_ROUND)))

    def gain(heading_deg: FloatArray) -> FloatArray:
        return best.gain(np.asarray(heading_deg, dtype=float)) + offset

    result = fit(replace(readings, gain_db=gain(readings.heading_deg)), options)
    result, gain_sigma = _with_error(result, best, options.receiver_offsets)
    shape = dict(zip(SHAPES.get(best.family, ()), [*best.values.tolist(), offset], strict=False))
    bic = dict(sorted(by_family.items(), key=lambda item: item[1]))
    return result, Pattern(best.family, best.name, best.parameters, gain, gain_sigma, bic, shape)


def _with_error(result: FitResult, best: _Candidate, receiver_offsets: bool) -> tuple[FitResult, Gain]:
    """The result with the pattern's error in its intervals, and the error of the gain itself.

    The pattern's parameters are given columns of their own, their derivatives, at the values found.
    """
    rows = _rows(result, receiver_offsets)
    slope = _centred(best.slope)
    columns = slope(rows.design[:, -1])
    k, p = columns.shape[1], rows.design.shape[1] - 1
    if k == 0:
        return result, _no_gain
    theta = np.concatenate([result.theta[:-1], np.zeros(k), result.theta[-1:]])
    full = replace(rows, design=np.column_stack([rows.design[:, :-1], columns]))
    penalty = np.zeros((len(theta), len(theta)))
    penalty[p : p + k, p : p + k] = best.penalty
    covariance, naive, quantile = clustered(theta, full, penalty)
    rest = [*range(p), p + k]
    of_pattern = covariance[p : p + k, p : p + k]
    wider = replace(
        result,
        covariance=covariance[np.ix_(rest, rest)],
        naive_covariance=naive[np.ix_(rest, rest)],
        quantile=quantile,
    )
    wider = replace(
        wider,
        intervals_95=intervals(wider),
        receiver_offsets_db=offsets_of(wider) if receiver_offsets else {},
    )

    def gain_sigma(heading_deg: FloatArray) -> FloatArray:
        by = slope(np.asarray(heading_deg, dtype=float))
        result: FloatArray = np.sqrt(np.maximum(np.einsum("...i,ij,...j", by, of_pattern, by), 0.0))
        return result

    return wider, gain_sigma


class _Search:
    """The distinct rows once, and the best member of each family on them."""

    def __init__(self, base: FitResult, receiver_offsets: bool) -> None:
        self.rows = _rows(base, receiver_offsets)
        self.heading = self.rows.design[:, -1]
        self.matrix = self.rows.design[:, :-1]
        self.start = base.theta
        self.exponent = base.antenna.path_loss_exponent
        # Readings that share their place are counted as if each were new evidence: where the naive variances
        # are too small by a factor, the log-likelihood is too large by it.
        ratio = np.diag(base.covariance) / np.diag(base.naive_covariance)
        self.inflation = max(1.0, float(np.median(ratio[:2])))
        self.log_places = float(np.log(base.n_places))

    def bic(self, candidate: _Candidate) -> float:
        return 2.0 * candidate.nll / self.inflation + candidate.parameters * self.log_places

    def family(self, name: Family) -> list[_Candidate]:
        if name == "circle":
            value = self._maximise(np.zeros_like(self.heading))[1]
            return [_Candidate(name, name, 0, _no_gain, value, _nothing, np.empty((0, 0)), np.empty(0))]
        if name == "fourier":
            return [self._linear(name, f"fourier {k}", families.fourier(k)) for k in families.FOURIER_ORDERS]
        if name == "spline":
            rough = families.roughness()
            return [
                self._linear(name, name, families.spline(), self.inflation * rough / stiff**2)
                for stiff in families.STIFFNESS_DB
            ]
        if name == "ellipse":
            return [self._search(name, families.ellipse(self.exponent))]
        return [self._search(name, lambda *p: lambda h: SHAPE_OF[name](h, *p))]

    def _maximise(
        self, offset_db: FloatArray, columns: FloatArray | None = None, penalty: FloatArray | None = None
    ) -> tuple[FloatArray, float, Rows]:
        extra = np.empty((len(self.heading), 0)) if columns is None else columns
        rows = replace(
            self.rows,
            design=np.column_stack([self.matrix, extra]),
            offset_dbm=self.rows.offset_dbm + offset_db,
        )
        start = np.concatenate([self.start[:-1], np.zeros(extra.shape[1]), self.start[-1:]])
        theta, converged = likelihood.maximise(rows, start, penalty)
        return theta, likelihood.nll(theta, rows) if converged else np.inf, rows

    def _rough(self, offset_db: FloatArray) -> float:
        """Least squares on what was received: a thousand times faster, and good enough to begin from."""
        rows = self.rows
        use = np.isfinite(rows.low_dbm) & np.isfinite(rows.high_dbm)
        level = 0.5 * (rows.low_dbm + rows.high_dbm)[use] - (rows.offset_dbm + offset_db)[use]
        root = np.sqrt(rows.count[use])
        matrix = self.matrix[use] * root[:, None]
        fitted, *_ = np.linalg.lstsq(matrix, level * root, rcond=None)
        return float(((level * root - matrix @ fitted) ** 2).sum())

    def _linear(
        self, family: Family, name: str, basis: Basis, penalty: FloatArray | None = None
    ) -> _Candidate:
        columns = basis(self.heading)
        k, p = columns.shape[1], self.matrix.shape[1]
        ridge = np.zeros((p + k + 1, p + k + 1))
        smooth = np.zeros((k, k)) if penalty is None else penalty
        ridge[p : p + k, p : p + k] = smooth
        theta, value, rows = self._maximise(np.zeros_like(self.heading), columns, ridge)
        weights = theta[p:-1]
        bend = likelihood.hessian(theta, rows)
        # Effective number of parameters: the trace of what the smoothing lets through.
        through = np.trace(np.linalg.pinv(bend + ridge) @ bend) - (len(theta) - k)
        effective = float(k if penalty is None else np.clip(through, 1.0, k))
        return _Candidate(
            family, name, effective, lambda h: basis(h) @ weights, value, basis, smooth, weights
        )

    def _search(self, family: Family, shape: Callable[..., Gain]) -> _Candidate:
        """Families that are not linear: the best of a coarse grid, then downhill from there."""
        from scipy.optimize import minimize

        def cost(p: FloatArray) -> float:
            return self._maximise(shape(*p)(self.heading))[1]

        start = min(families.starts(family), key=lambda p: self._rough(shape(*p)(self.heading)))
        found = minimize(
            cost, start, method="Nelder-Mead", options={"xatol": 0.02, "fatol": 0.01, "maxfev": 200}
        )
        best = found.x if found.fun <= cost(start) else start
        return _Candidate(
            family,
            family,
            len(best),
            shape(*best),
            cost(best),
            _derivative(shape, best),
            np.zeros((len(best), len(best))),
            best,
        )


def _rows(result: FitResult, receiver_offsets: bool) -> Rows:
    """The fit's distinct rows with the heading as the last column of the design."""
    heading = np.asarray(result.readings.heading_deg)[:, None]
    saturation = result.antenna.saturation_dbm
    return make_rows(result.readings, result.missed, result.censor_dbm, saturation, receiver_offsets, heading)


def _derivative(shape: Callable[..., Gain], at: FloatArray, step: float = 0.05) -> Basis:
    """By central differences."""

    def slope(heading_deg: FloatArray) -> FloatArray:
        columns = []
        for i in range(len(at)):
            move = np.zeros_like(at)
            move[i] = step
            columns.append(
                (shape(*(at + move))(heading_deg) - shape(*(at - move))(heading_deg)) / (2.0 * step)
            )
        return np.stack(columns, axis=-1)

    return slope


def _centred(slope: Basis) -> Basis:
    """Of a gain that averages zero."""
    mean = slope(ALL_ROUND).mean(axis=0)
    return lambda heading: slope(heading) - mean


def _no_gain(heading_deg: FloatArray) -> FloatArray:
    return np.zeros_like(np.asarray(heading_deg, dtype=float))


def _nothing(heading_deg: FloatArray) -> FloatArray:
    return np.zeros((*np.shape(heading_deg), 0))
