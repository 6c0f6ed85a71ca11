"""One possible source: its posterior over place and power, the detections that support it, its rate.

The posterior lives on a cloud of points finer than the grid, jointly with the power hypothesis. The rate is
integrated out: with prior Gamma(a, b) and exposure E, n receptions weigh (b + E)^-(a + n). Points that have
become impossible are dropped, so a candidate that sharpens becomes cheap.
"""

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln, ndtr

from fieldkit.engine.belief.intensity import loops
from fieldkit.engine.belief.intensity.arena import Arena, Row, starts
from fieldkit.messages import FloatArray
from fieldkit.tuning import IntensityTuning

NEGLIGIBLE_FROZEN = 3.0
"""By so many nats a point that was dropped is less probable than the least of those that were kept, or by more."""
MOST_FROZEN = 10.0
"""Nats that one reception can cost: it may have been an outlier."""
SHARED_LEAST = 0.2
"""An error of positions that is less than this part of what is asked is left out."""
ACTIVE_NATS = 40.0
"""A detection may lower an entry by this much and still have it count when it is left out."""


def active_entries(log_posterior: FloatArray) -> NDArray[np.intp]:
    """Flat indices of the entries of (h, n) that can count for anything."""
    flat = log_posterior.ravel()
    return np.flatnonzero(flat > flat.max() - ACTIVE_NATS)


def log_sum(logs: FloatArray) -> float:
    """log of the sum of exp(logs): scipy's does the same for arrays of any kind, at fifty times the overhead."""
    best = float(logs.max())
    return best + float(np.log(np.exp(logs - best).sum()))


@dataclass(frozen=True, slots=True, eq=False)
class TwoSource:
    """The hypothesis that a candidate is two sources, while it cannot be distinguished from that of one."""

    probability: float
    places_m: FloatArray
    """(2, 2) where the two would be."""
    undecided: bool
    """Whether it is likely enough to go and see."""


@dataclass
class Candidate:
    """Arrays over the cloud are (h, n): power hypothesis by point."""

    ident: int
    points_m: FloatArray
    log_prior: FloatArray
    """(h, n), sums (as probability) to the expected number of sources under the cloud."""
    rate_prior_s: float
    """b of the Gamma prior."""
    exposure_s: FloatArray
    """(h, n) P(heard) integrated over the time listened."""
    spacing_m: float
    """Between neighbouring points."""
    arena: Arena
    """Where log-likelihoods are kept: one for all candidates that attribute detections among them."""
    tuning: IntensityTuning
    evidence: FloatArray = field(init=False)
    """(h, n) sum of responsibility times log-likelihood."""
    logs: dict[int, Row] = field(default_factory=dict)
    """Detection number to its log-likelihood over the cloud, for all detections that may be this source's."""
    responsibility: dict[int, float] = field(default_factory=dict)
    """Detection number to the probability that this source sent it."""
    rate_trust: float = 1.0
    """How much its number of receptions says of how far it is heard: less where they were made at few places."""
    based_on: dict[int, list[int]] = field(default_factory=dict)
    """Detection number to the earlier ones its log-likelihood is conditioned on; empty without place noise."""
    frozen_receptions: float = 0.0
    """Receptions that are marginalised: their likelihoods are in the evidence for good."""
    log_absent: float = 0.0
    """log P(it sent none of those): what its existence rests on does not go with them."""
    first_ns: int | None = None
    """When the first of the detections it claims was sent."""
    last_ns: int = 0
    """When the last of them was."""
    exposure_then_s: float = 0.0
    """How long it had been listened to by then."""
    listened_at: dict[int, float] = field(default_factory=dict)
    """Detection number to how long it had been listened to when that came, in seconds; of those it may have sent."""
    certain_since: float | None = None
    """Receptions when its place first became certain enough, since it last was not."""
    wider: float = 1.0
    """By how much the squares of readings' residuals are larger than the antenna file says: what is claimed is so much
    less sharp (quasi-likelihood; McCullagh and Nelder, Generalized Linear Models, 9.2)."""
    two_source: TwoSource | None = None
    name: str = ""
    """The address it sends under, where sources are distinguished by it."""
    state: str = "candidate"
    note: str = ""

    def __post_init__(self) -> None:
        self.evidence = np.zeros_like(self.log_prior)
        self._receptions: float | None = None
        self.expose(self.exposure_s)

    def copy(self) -> "Candidate":
        """Another that has the same arrays but claims for itself."""
        other = copy.copy(self)
        other.logs, other.responsibility = dict(self.logs), dict(self.responsibility)
        other.based_on, other.listened_at = dict(self.based_on), dict(self.listened_at)
        other.evidence = self.evidence.copy()
        return other

    @property
    def receptions(self) -> float:
        """Expected number of receptions it has sent."""
        if self._receptions is None:
            # Python's own sum rounds differently from 3.12 on; a replay must not.
            self._receptions = self.frozen_receptions + math.fsum(self.responsibility.values())
        return self._receptions

    def log_posterior(self) -> FloatArray:
        """(h, n), not normalised."""
        return self.log_prior + self.evidence - (self.tuning.rate_shape + self.receptions) * self.log_exposure

    def expose(self, exposure_s: FloatArray) -> None:
        """Bring the exposure (h, n) up to date."""
        self.exposure_s = exposure_s
        self.log_exposure = self.rate_trust * np.log(self.rate_prior_s + exposure_s)

    def posterior(self) -> FloatArray:
        """(h, n), sums to 1."""
        return self._normalised(1.0)

    def claimed_posterior(self) -> FloatArray:
        """(h, n), sums to 1: what may be claimed of it, where readings scatter wider than the antenna file says."""
        return self._normalised(self.wider)

    def _normalised(self, wider: float) -> FloatArray:
        log = self.log_posterior()
        weights = np.exp((log - log.max()) / wider)
        return np.asarray(weights / weights.sum())

    def log_evidence(self) -> float:
        """log of the expected number of such sources times the probability of all they sent: compares hypotheses."""
        n = self.receptions
        rate = (
            self.tuning.rate_shape * np.log(self.rate_prior_s)
            + gammaln(self.tuning.rate_shape + n)
            - gammaln(self.tuning.rate_shape)
        )
        log = self.log_posterior()
        total = log_sum(log)
        if self.rate_trust < 1.0:
            # Its posterior trusts exposures less; how much it sent is measured by all that it was listened to there.
            weights = np.exp(log - total)
            total -= (
                (1.0 / self.rate_trust - 1.0)
                * (self.tuning.rate_shape + n)
                * float((weights * self.log_exposure).sum())
            )
        return total + float(rate)

    def know(self, number: int, log_likelihood: FloatArray) -> None:
        """Have a detection at hand that this source may have sent; its responsibility is 0 until claimed."""
        self.logs[number] = self.arena.put(log_likelihood)
        self.responsibility.setdefault(number, 0.0)

    def set_responsibility(self, number: int, responsibility: float) -> None:
        """Claim a detection with this probability."""
        self.evidence += (responsibility - self.responsibility[number]) * self.logs[number].array
        self.responsibility[number] = responsibility
        self._receptions = None

    def set_responsibilities(self, numbers: Sequence[int], responsibilities: Sequence[float]) -> None:
        """Claim each of several detections with its probability, at once."""
        loops.add_rows(
            self.arena.values,
            starts([self.logs[number] for number in numbers]),
            np.array(
                [
                    responsibility - self.responsibility[number]
                    for number, responsibility in zip(numbers, responsibilities, strict=True)
                ]
            ),
            self.evidence.reshape(-1),
        )
        self.responsibility.update(zip(numbers, responsibilities, strict=True))
        self._receptions = None

    def mean_exposure_s(self, posterior: FloatArray) -> float:
        return float((posterior * self.exposure_s).sum())

    def frozen(self) -> FloatArray:
        """(h, n) what the evidence has from detections that are marginalised."""
        claimed = (
            responsibility * self.logs[number].array
            for number, responsibility in self.responsibility.items()
            if responsibility > 0.0
        )
        return np.asarray(self.evidence - sum(claimed, start=np.zeros_like(self.evidence)))

    def take_in_frozen(self, other: "Candidate") -> None:
        """Add what is marginalised of another."""
        self._count_frozen(other)
        self._add_frozen(other, other.frozen())

    def _count_frozen(self, other: "Candidate") -> None:
        self.frozen_receptions += other.frozen_receptions
        self.log_absent += other.log_absent
        self._receptions = None

    def _add_frozen(self, other: "Candidate", theirs: FloatArray) -> None:
        """Its marginalised evidence `theirs`, at its points nearest to one's own.

        Beyond the points that the other has kept it falls on as a normal density that is as wide as they are, by so
        much for each marginalised reception at the most: hundreds of them were not sent from another source's place.
        """
        away2 = (self.points_m[:, None, 0] - other.points_m[None, :, 0]) ** 2
        away2 += (self.points_m[:, None, 1] - other.points_m[None, :, 1]) ** 2
        nearest = away2.argmin(axis=1)
        off2 = away2.min(axis=1)
        far = off2 > max(self.spacing_m, other.spacing_m) ** 2
        weight = np.exp(theirs - theirs.max()).sum(axis=0)
        weight /= weight.sum()
        spread2 = weight @ ((other.points_m - weight @ other.points_m) ** 2).sum(axis=1) / 2.0
        fall = 0.5 * off2 / (spread2 + other.spacing_m**2 / 12.0)
        least = theirs.min(axis=1)[:, None] - NEGLIGIBLE_FROZEN
        beyond = np.minimum(
            least, theirs[:, nearest] - np.minimum(fall, MOST_FROZEN * other.frozen_receptions)
        )
        self.evidence += np.where(far[None], beyond, theirs[:, nearest])

    def with_frozen_alone(self) -> "Candidate":
        """Another that knows and claims nothing but what is marginalised."""
        other = copy.copy(self)
        other.evidence = self.frozen()
        other.logs, other.responsibility, other.based_on, other.listened_at = {}, {}, {}, {}
        other._receptions = None
        return other

    def prune(self) -> None:
        """Drop points that are impossible under every power."""
        log = self.log_posterior()
        best = log.max(axis=0)
        keep = best > best.max() - self.tuning.negligible_nats
        if keep.sum() < self.tuning.fewest_points < keep.size:
            keep[np.argpartition(best, -self.tuning.fewest_points)[-self.tuning.fewest_points :]] = True
        if keep.sum() > 0.8 * keep.size:
            return
        self.points_m = np.ascontiguousarray(self.points_m[keep])
        self.log_prior = np.ascontiguousarray(self.log_prior[:, keep])
        self.expose(np.ascontiguousarray(self.exposure_s[:, keep]))
        self.evidence = np.ascontiguousarray(self.evidence[:, keep])
        for number, row in self.logs.items():
            self.logs[number] = self.arena.put(row.array[:, keep])

    def forget(self, number: int) -> None:
        """Marginalise a detection: its likelihood stays in the evidence, and its responsibility is final."""
        if number in self.logs:
            responsibility = self.responsibility.pop(number)
            self.frozen_receptions += responsibility
            self.log_absent += math.log1p(-min(responsibility, 1.0 - 1e-9))
            del self.logs[number]
            self.based_on.pop(number, None)
            self.listened_at.pop(number, None)
            self._receptions = None


@dataclass(frozen=True, slots=True)
class Summary:
    """A candidate's posterior in a few numbers."""

    mean_m: FloatArray
    cov_m2: FloatArray
    p_here: float
    power_db: float
    p_outside: float
    exposure_s: float
    p_in_field: float
    shared_sigma_m: float
    """How far the positions it was heard from may be off together: what no number of readings of a minute mends."""


def summarise(
    candidate: Candidate,
    posterior: FloatArray,
    power_db: FloatArray,
    outside: FloatArray,
    cell_m: float,
    radius_m: float | None = None,
    in_field: NDArray[np.bool_] | None = None,
    shared_sigma_m: float = 0.0,
) -> Summary:
    """Mean place, covariance, and the probability of being within one cell (or a radius) of the mean.

    `shared_sigma_m` is by how much all positions it was heard from may be off together. `power_db` (h - 1,) of the
    fixed hypotheses; the varying one counts as their known mean. `in_field` (n,) says which points lie in the field;
    None: all.
    """
    place = posterior.sum(axis=0)
    mean = place @ candidate.points_m
    offset = candidate.points_m - mean
    cov = (offset * place[:, None]).T @ offset + shared_sigma_m**2 * np.eye(2)
    if shared_sigma_m > SHARED_LEAST * (radius_m or cell_m):
        # The circle as a square of the same area: its sides are independent.
        half_m = 0.5 * np.sqrt(np.pi) * radius_m if radius_m is not None else 1.0 * cell_m
        inside = ndtr((half_m - offset) / shared_sigma_m) - ndtr((-half_m - offset) / shared_sigma_m)
        here = inside.prod(axis=1)
    elif radius_m is None:
        here = (np.abs(offset) <= cell_m).all(axis=1).astype(float)
    else:
        here = (np.hypot(offset[:, 0], offset[:, 1]) <= radius_m).astype(float)
    by_power = posterior.sum(axis=1)
    fixed = by_power[:-1]
    power = float(fixed @ power_db / max(fixed.sum(), 1e-12))
    return Summary(
        mean,
        cov,
        float(place @ here),
        power,
        float(by_power[outside].sum()),
        candidate.mean_exposure_s(posterior),
        1.0 if in_field is None else float(place[in_field].sum()),
        shared_sigma_m,
    )


def merged_gain(
    first: Candidate, second: Candidate, settle: Callable[[Candidate], object] | None = None
) -> float:
    """log evidence of `first` having sent all that both sent, over two sources having sent it.

    Where responsibilities are divided, the two-source hypothesis is credited with their entropy (variational bound).

    `settle` conditions the detections of one that claims them all on each other, as each of the two has its own:
    else what both heard at one place would count twice against there being one source.
    -inf where `first` has not got the other's detections at hand. Where it is at most 0, that is all it says.
    """
    claimed = {
        number: responsibility
        for number, responsibility in second.responsibility.items()
        if responsibility > 0.02
    }
    if any(number not in first.logs for number in claimed):
        return -np.inf
    apart = first.log_evidence() + second.log_evidence()
    for number, responsibility in claimed.items():
        both = np.array([responsibility, first.responsibility[number]])
        parts = both / both.sum()
        apart -= float(both.sum() * (parts * np.log(np.maximum(parts, 1e-12))).sum())
    both_sent = first.copy()
    both_sent.set_responsibilities(
        list(claimed),
        [
            min(1.0, first.responsibility[number] + responsibility)
            for number, responsibility in claimed.items()
        ],
    )
    if second.frozen_receptions > 0.0:
        theirs = second.frozen()
        both_sent._count_frozen(second)
        if settle is None and (most := both_sent.log_evidence() + float(theirs.max()) - apart) <= 0.0:
            return most  # whatever is nearest to what
        both_sent._add_frozen(second, theirs)
    if settle is not None:
        settle(both_sent)
    return both_sent.log_evidence() - apart
