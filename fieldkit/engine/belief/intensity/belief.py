"""The default belief: transmissions as a spatial Poisson process, silence as exposure, sources as a mixture.

The mixture decides who sent what; this file decides what may be said of it: candidate, found, inconsistent.

Ground where the team listened and heard nothing is known to be emptier: a source that sends at a Gamma(a, b) rate
is still there, unheard after exposure E, with weight (b / (b + E))^a.
"""

import hashlib
from collections.abc import Sequence
from operator import is_

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammainc, gammaincinv

from fieldkit.engine.belief.base import Unresolved
from fieldkit.engine.belief.intensity.candidate import Candidate, Summary
from fieldkit.engine.belief.intensity.mixture import Mixture
from fieldkit.engine.belief.intensity.region import smallest_region
from fieldkit.engine.belief.intensity.silence import expected_asleep, gone_probability, gone_silent, silence
from fieldkit.engine.belief.intensity.silence import words as silence_words
from fieldkit.engine.belief.intensity.unknown import expected_unknown
from fieldkit.engine.likelihood.ears_loops import NORTH, UP
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Detection, FloatArray, Listening, SourceEstimate


class IntensityBelief:
    """See the module. Not thread-safe; deterministic."""

    def __init__(self, settings: EngineSettings) -> None:
        self.settings, self._tuning = settings, settings.tuning.intensity
        self.grid = settings.grid
        self.mixture = Mixture(settings)
        self.model = self.mixture.model
        self._silent: set[int] = set()
        self._wider_said = False
        self._misfits: dict[int, tuple[list[Detection], tuple[float, ...], tuple[float, int]]] = {}
        """Of a candidate: what it was last judged by, and how that came out."""

    @property
    def candidates(self) -> list[Candidate]:
        """The sources believed in, in order of birth."""
        return self.mixture.candidates

    @property
    def exposure_s(self) -> FloatArray:
        """(h - 1, n_north, n_east): P(some robot hears) integrated over the time listened, by power hypothesis."""
        return self.mixture.ground.of_field(self.mixture.exposure_s)

    def listen(self, listening: Listening) -> None:
        """Take in a stretch of listening: silence where nothing is detected."""
        self.mixture.listen(listening)

    def detect(self, detection: Detection) -> None:
        """Take in a transmission, judge the candidates anew, and think it over."""
        self.detect_all((detection,))
        self.reflect()

    def detect_all(self, detections: Sequence[Detection]) -> None:
        """Take in several with one look at who sent what; `reflect` re-estimates hypotheses."""
        self.mixture.detect(detections)
        self._judge()

    def reflect(self) -> bool:
        """Re-estimate a candidate's hypothesis where that is due; whether another hypothesis was better."""
        changed = self.mixture.reflect()
        if changed is not None:
            self._judge()
        return self._look_for_silent() or changed is not None

    def _look_for_silent(self) -> bool:
        """Whether a source has gone silent since this was last asked, or is heard again."""
        silent = gone_silent(self.mixture)
        changed, self._silent = silent != self._silent, silent
        return changed

    def part_with_robots(self) -> None:
        """All robots so far are heard no more: others come. What was learnt of their receivers stays."""
        self.mixture.watch.close(self.mixture.spread)

    def said(self) -> list[str]:
        """What is new to say of the receivers since this was last asked."""
        said, self.mixture.said = self.mixture.said, []
        return said

    def _judge(self) -> None:
        """Candidate, found or inconsistent; a find that later evidence takes back says why."""
        threshold = self.settings.found_probability
        self.mixture.widen(wider := self._wider())
        if wider >= self._tuning.wider_said and not self._wider_said:
            self._wider_said = True
            self.mixture.said.append(
                f"readings scatter {np.sqrt(wider):.1f} times as wide as the antenna file's sigma of "
                f"{self.settings.antenna.sigma_db:.1f} dB: positions are claimed less sharp by as much"
            )
        for candidate in self.candidates:
            summary = self.mixture.summary(candidate)
            enough = candidate.receptions >= self.settings.min_receptions - 0.1
            if enough and summary.p_in_field < 0.5:
                candidate.certain_since = None
                candidate.state = "outside"
                candidate.note = self.mixture.ground.said_of(summary.mean_m)
                continue
            if candidate.state == "outside":
                candidate.state, candidate.note = "candidate", ""
            placed = summary.p_here >= (
                threshold if candidate.state != "found" else self._tuning.withdraw * threshold
            )
            if not (enough and placed):
                candidate.certain_since = None
                if candidate.state == "found":
                    candidate.note = f"withdrawn: probability of being here fell to {summary.p_here:.2f}"
                candidate.state = "candidate"
                continue
            if candidate.state == "candidate" and self._fresh_evidence(candidate):
                continue
            doubt = self._doubt(candidate, summary)
            candidate.state = "inconsistent" if doubt else "found"
            candidate.note = doubt or self._may_be_two(candidate)

    def _wider(self) -> float:
        """By how much squared residuals are larger than they should be, over all candidates; no less than 1.

        Receivers and transmitters of a field have antennas that no file has: what they do to all is learnt from all.
        """
        known = [
            self._misfit(candidate)
            for candidate in self.candidates
            if candidate.receptions >= self.settings.min_receptions - 0.1
        ]
        count = self._tuning.residuals_trusted + sum(number for _, number in known)
        squares = self._tuning.residuals_trusted + sum(misfit * number for misfit, number in known)
        return max(1.0, squares / count)

    def _may_be_two(self, candidate: Candidate) -> str:
        """What to know of a find that is as well explained as two sources; empty for others."""
        two_source = candidate.two_source
        if two_source is None or two_source.probability < 0.1:
            return ""
        (east, north), (east2, north2) = two_source.places_m
        return (
            f"may be two sources, at {east:.1f}, {north:.1f} m and {east2:.1f}, {north2:.1f} m, "
            f"with probability {two_source.probability:.2f}"
        )

    def _fresh_evidence(self, candidate: Candidate) -> bool:
        """Whether this is the first look at which the place is certain enough: a find must outlast one reception.

        The moment a probability first crosses a threshold is picked for being high; one more independent reception
        that leaves it there proves more than a higher threshold.
        """
        if candidate.certain_since is None:
            candidate.certain_since = candidate.receptions
        return candidate.receptions < candidate.certain_since + 0.7

    def _doubt(self, candidate: Candidate, summary: Summary) -> str:
        """Why the readings do not look like what the antenna file predicts; empty when they do."""
        if summary.p_outside > 0.5:
            return (
                f"the model does not explain these readings: they look like a source {summary.power_db:+.0f} dB from "
                f"the calibrated one, outside the power levels given ({min(self.settings.power_levels_db):+.0f} to "
                f"{max(self.settings.power_levels_db):+.0f} dB)"
            )
        misfit, count = self._misfit(candidate)
        if count >= 5 and misfit > self._tuning.max_squared_residual:
            return (
                f"the model does not explain these readings: residuals are {np.sqrt(misfit):.1f} times as wide as "
                f"the antenna file's sigma of {self.settings.antenna.sigma_db:.1f} dB ({count} readings)"
            )
        return ""

    def _misfit(self, candidate: Candidate) -> tuple[float, int]:
        """Mean squared standardised residual of the readings it claims, at the most probable place and power."""
        log = candidate.log_posterior()[:-1]
        level, index = np.unravel_index(int(np.argmax(log)), log.shape)
        claimed = [
            self.mixture.open[number]
            for number, responsibility in candidate.responsibility.items()
            if responsibility >= 0.5
        ]
        if not claimed:
            return 0.0, 0
        if self.mixture.places is not None:
            last = [stored.detection for stored in claimed[-self._tuning.judged_on :]]
            return self._misfit_in_places(candidate, last, candidate.points_m[index], int(level))
        ears = np.concatenate([stored.ears for stored in claimed])
        rss = np.concatenate([stored.rss_dbm for stored in claimed])
        point = candidate.points_m[index]
        distance = np.sqrt(((ears[:, : NORTH + 1] - point) ** 2).sum(axis=1) + ears[:, UP] ** 2)
        mean = self.model.level_dbm[level] - self.mixture.ears.attenuation_db(point[None], ears)[0]
        squares = ((rss - mean) / self.model.spread_db(distance)) ** 2
        use = np.isfinite(rss)
        count = int(use.sum())
        return (
            float(np.minimum(squares[use], 12.0).mean()) if count else 0.0
        ), count  # one outlier is no misfit

    def _misfit_in_places(
        self, candidate: Candidate, detections: list[Detection], point_m: FloatArray, level: int
    ) -> tuple[float, int]:
        """The same under place noise; as it was where nothing of it has changed, which is so of most candidates."""
        places, now = self.mixture.places, (*point_m.tolist(), level)
        held, before, known = self._misfits.get(candidate.ident, ([], (), (0.0, 0)))
        same = before == now and len(held) == len(detections) and all(map(is_, held, detections))
        if places is not None and not same:
            known = places.misfit(detections, point_m, float(self.model.level_dbm[level]))
            self._misfits[candidate.ident] = detections, now, known
        return known

    def sources(self) -> list[SourceEstimate]:
        """Candidates with at least one reception, by identity."""
        estimates = []
        for candidate in self.candidates:
            summary = self.mixture.summary(candidate)
            silent = silence(self.mixture, candidate)
            note = candidate.note
            if candidate.ident in self._silent:
                said = silence_words(self.mixture, candidate, silent)
                note = f"{note}; {said}" if note else said
            estimates.append(
                SourceEstimate(
                    ident=candidate.ident,
                    east_m=float(summary.mean_m[0]),
                    north_m=float(summary.mean_m[1]),
                    cov_m2=summary.cov_m2,
                    region_90=self._region_90(candidate),
                    receptions=candidate.receptions,
                    rate_hz=(self._tuning.rate_shape + candidate.receptions)
                    / (self.mixture.rate_prior_s + summary.exposure_s),
                    p_exists=1.0
                    - float(np.prod([1.0 - min(r, 1.0 - 1e-9) for r in candidate.responsibility.values()]))
                    * float(np.exp(candidate.log_absent)),
                    p_here=summary.p_here,
                    state=candidate.state,  # type: ignore[arg-type]
                    note=note,
                    name=candidate.name,
                    power_db=summary.power_db,
                    last_heard_ns=silent.since_ns,
                    silence_odds=silent.odds,
                )
            )
        return estimates

    def _spread_out(self, candidate: Candidate) -> tuple[FloatArray, FloatArray]:
        """Its points (n, 2) and the posterior of each; one that stands for several cells has a part in each of them."""
        place = np.asarray(candidate.claimed_posterior().sum(axis=0))
        parts = round(candidate.spacing_m / self.grid.cell_m)
        if parts < 2:
            return candidate.points_m, place
        along = ((np.arange(parts) + 0.5) / parts - 0.5) * candidate.spacing_m
        offsets = np.column_stack([np.tile(along, parts), np.repeat(along, parts)])
        points = (candidate.points_m[:, None] + offsets).reshape(-1, 2)
        return points, np.repeat(place / parts**2, parts**2)

    def _cells_of(self, candidate: Candidate) -> tuple[NDArray[np.intp], FloatArray]:
        """Flat indices of cells of the field, and the posterior of each; what lies outside is left out."""
        points, place = self._spread_out(candidate)
        column = np.floor((points[:, 0] - self.grid.west_m) / self.grid.cell_m).astype(int)
        row = np.floor((points[:, 1] - self.grid.south_m) / self.grid.cell_m).astype(int)
        inside = (row >= 0) & (row < self.grid.n_north) & (column >= 0) & (column < self.grid.n_east)
        flat = (row * self.grid.n_east + column)[inside]
        cells = np.unique(flat)
        weight = np.bincount(np.searchsorted(cells, flat), weights=place[inside], minlength=cells.size)
        return cells, np.asarray(weight, dtype=float)

    def region_90(self, candidate: Candidate) -> set[tuple[int, int]]:
        """The cells (row, column) of the smallest region that holds 90 % of the location posterior.

        Those outside the field have numbers that no cell of it has.
        """
        points, place = self._spread_out(candidate)
        shared_m = self.mixture.summary(candidate).shared_sigma_m
        return smallest_region(points, place, self.grid.cell_m, shared_m, 0.9)

    def _region_90(self, candidate: Candidate) -> int:
        return len(self.region_90(candidate))

    def presence(self) -> FloatArray:
        """(n_north, n_east) probability that the cell holds a source, heard or not."""
        b = self.mixture.rate_prior_s
        unseen = (self.settings.expected_sources / self.grid.n_cells) * (
            b / (b + self.mixture.ground.of_field(self.mixture.known_exposure_s().mean(axis=0)))
        )
        log_absent = np.log1p(-np.minimum(unseen, 0.999)).ravel()
        for candidate in self.candidates:
            cells, place = self._cells_of(candidate)
            log_absent[cells] += np.log1p(-np.minimum(place * min(1.0, candidate.receptions), 1.0 - 1e-9))
        result: FloatArray = (1.0 - np.exp(log_absent)).reshape(self.grid.shape)
        return result

    def activity(self) -> FloatArray:
        """(n_north, n_east), sums to 1: expected rate of transmissions by cell."""
        ground = self.mixture.ground
        rate = ground.of_field(self.mixture.unknown_rate()).ravel() / ground.factor**2
        for candidate in self.candidates:
            cells, place = self._cells_of(candidate)
            hz = (self._tuning.rate_shape + candidate.receptions) / (
                self.mixture.rate_prior_s + self.mixture.summary(candidate).exposure_s
            )
            rate[cells] += place * hz
        result: FloatArray = (rate / rate.sum()).reshape(self.grid.shape)
        return result

    def probability_left(self) -> float:
        """P(at least one source not found): unheard ground, and candidates not yet found.

        Rates are Gamma distributed as those of candidates, but for senders slower than `slowest` of the reference
        rate: of those nobody can be sure in any time, and `left_words` says so.
        """
        rates_hz, weights = rates_above(
            self.settings.reference_rate_hz, self._tuning.rate_shape, self._tuning.slowest
        )
        expected = sum(
            weight * float(self._another_source(rate).sum())
            for rate, weight in zip(rates_hz, weights, strict=True)
        )
        none_left = float(np.exp(-expected - expected_asleep(self.mixture, self._silent)))
        for candidate in self.candidates:
            if candidate.state != "found":
                in_field = self.mixture.summary(candidate).p_in_field
                none_left *= 1.0 - min(1.0, candidate.receptions) * in_field
            elif candidate.two_source is not None:
                none_left *= 1.0 - candidate.two_source.probability
        return float(1.0 - none_left)

    # -- for planners ------------------------------------------------------------------------------------

    def ground_value(self) -> FloatArray:
        """(n_north, n_east) expected number of sources of the reference rate that are not among the candidates."""
        result: FloatArray = np.minimum(self._another_source(), 0.5)
        return result

    def left_words(self) -> str:
        """For which senders `probability_left` holds."""
        slowest_s = 1.0 / (self._tuning.slowest * self.settings.reference_rate_hz)
        asleep = (
            f"; of those known {len(self._silent)} went silent, and others may sleep as they do"
            if self._silent
            else ""
        )
        return f"of sources that send at least once in {slowest_s:.0f} s on average{asleep}"

    def _another_source(self, rate_hz: float | None = None) -> FloatArray:
        """(n_north, n_east) the same, of the field alone, without a limit."""
        ground = self.mixture.ground
        return ground.of_field(expected_unknown(self.mixture, rate_hz)) / ground.factor**2

    def unresolved(self, samples: int, rng: np.random.Generator) -> list[Unresolved]:
        """What is to be listened to again: candidates not found, finds that may be two sources, lie a cell off or have
        ended.

        Each with samples of where and how strong it may be.
        """
        result = []
        for candidate in self.candidates:
            two_source = candidate.two_source
            if two_source is not None and not two_source.undecided:
                two_source = None
            summary = self.mixture.summary(candidate)
            if candidate.state == "outside" and summary.p_in_field < self._tuning.look_outside:
                continue
            p_gone = self._p_gone(candidate) if candidate.state == "found" else 0.0
            is_settled = (
                candidate.state == "found" and two_source is None and summary.p_here >= self._tuning.settled
            )
            if is_settled and p_gone == 0.0:
                continue
            posterior = candidate.claimed_posterior()
            picks = rng.choice(posterior.size, size=samples, p=posterior.ravel() / posterior.sum())
            hypothesis, point = np.divmod(picks, posterior.shape[1])
            level = np.where(hypothesis < self.model.power_db.size, hypothesis, self.model.n_known // 2)
            places, cov = candidate.points_m[point].copy(), summary.cov_m2
            if two_source is not None:
                two = round(samples * two_source.probability)
                places[:two] = two_source.places_m[np.arange(two) % 2]
                apart = two_source.places_m[1] - two_source.places_m[0]
                cov = cov + two_source.probability * np.outer(apart, apart) / 4.0
            result.append(
                Unresolved(
                    candidate.ident,
                    places,
                    level.astype(float),
                    cov,
                    (self._tuning.rate_shape + candidate.receptions)
                    / (self.mixture.rate_prior_s + summary.exposure_s),
                    candidate.receptions,
                    1.0 if is_settled else summary.p_here,
                    candidate.state,
                    two_source is not None,
                    p_gone,
                )
            )
        return result

    def _p_gone(self, find: Candidate) -> float:
        """Probability that a find is no longer there, where that is worth another look; else 0."""
        if find.ident in self._silent:
            return 0.0
        p_gone = gone_probability(self.mixture, find)
        return p_gone if p_gone >= self._tuning.doubted else 0.0

    def digest(self) -> bytes:
        """SHA-256 over exposure and every candidate's cloud, evidence and responsibilities."""
        state = hashlib.sha256(self.exposure_s.tobytes())
        for candidate in self.candidates:
            two_source = candidate.two_source.probability if candidate.two_source is not None else 0.0
            state.update(
                f"{candidate.ident} {candidate.state} {candidate.frozen_receptions!r} {two_source!r}".encode()
            )
            state.update(candidate.points_m.tobytes())
            state.update(candidate.evidence.tobytes())
            state.update(repr(sorted(candidate.responsibility.items())).encode())
        return state.digest()


def rates_above(
    reference_hz: float, shape: float, slowest: float, count: int = 3
) -> tuple[FloatArray, FloatArray]:
    """Rates and their weights that stand for a Gamma distribution of mean `reference_hz`, from `slowest` of it on.

    Each is the median of one of `count` parts that are equally probable.
    """
    scale = reference_hz / shape
    low = gammainc(shape, slowest * reference_hz / scale)
    middle = low + (np.arange(count) + 0.5) / count * (1.0 - low)
    return np.asarray(gammaincinv(shape, middle) * scale), np.full(count, 1.0 / count)
