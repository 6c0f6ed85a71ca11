"""The default belief: transmissions as a spatial Poisson process, silence as exposure, sources as a mixture.

Every detection came from one of the sources found so far, from one not yet known, or from nowhere (clutter).
Shares are set by what the other detections of a source predict (collapsed variational mixture, zeroth order),
so that one good reading does not vouch for itself. A detection nobody claims gives birth to a candidate; two
candidates are one when one explains what both sent better; a candidate nobody supports dies.

Ground where the team listened and heard nothing is known to be emptier: a source that sends as a Gamma(a, b)
rate is still there, unheard after exposure E, with weight (b / (b + E))^a.

Detections long decided are folded into their sources, so cost does not grow with their number.
"""

import copy
import hashlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from fieldkit.engine import kernels
from fieldkit.engine.belief.candidate import RATE_SHAPE, Candidate, Summary, merged_gain, summarise
from fieldkit.engine.sensing.levels import LevelsModel
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Detection, FloatArray, Listening, SourceEstimate

MAX_OPEN = 300
"""Detections kept open for re-attribution; older ones are folded into their sources."""
CLUTTER_HZ = 2e-4
"""Rate of detections that come from no source: noise, other bands, reflections."""
FINE = 0.5
"""Spacing of a candidate's points, in cells."""
SWEEPS = 3
REVISE_AT = 5.0
"""Receptions at which a candidate's story is first told afresh; then at every 1.4 times as many."""
BIRTH_ODDS = 1.5
"""Expected number of further sources that speak for themselves at which one is given a candidate."""
DEATH_RECEPTIONS = 0.3
WITHDRAW = 0.75
"""A find is withdrawn when the probability of its place falls below this share of the threshold."""
MAX_SQUARED_RESIDUAL = 2.5
"""Mean squared standardised residual above which readings do not look like what the antenna file predicts."""


def _clutter(stored: "_Open") -> float:
    """log intensity with which noise explains a detection: any strength within 80 dB."""
    return float(np.log(CLUTTER_HZ) - int(stored.detection.heard.sum()) * np.log(80.0))


@dataclass(frozen=True, slots=True)
class Unresolved:
    """What a planner needs to know of a candidate: samples of where and how strong it may be."""

    ident: int
    points_m: FloatArray
    """(k, 2) equally likely places."""
    level: FloatArray
    """(k,) index of the fixed power hypothesis there."""
    cov_m2: FloatArray
    rate_hz: float
    receptions: float
    p_here: float
    state: str


@dataclass(frozen=True, slots=True, eq=False)
class _Open:
    """A stored detection: its likelihood over the cells near it, scaled to a maximum of 1."""

    detection: Detection
    box: tuple[int, int, int, int]
    like: FloatArray
    """(known levels, cells of the box, row by row)"""
    log_scale: float
    near_m: FloatArray
    """(k, 2) where it was heard."""


class IntensityBelief:
    """See the module. Not thread-safe; deterministic."""

    def __init__(self, settings: EngineSettings) -> None:
        self.settings = settings
        self.grid = settings.grid
        self.model = LevelsModel(
            settings.antenna,
            settings.power_levels_db,
            float(np.hypot(settings.pose_sigma_m, FINE * settings.grid.cell_m / np.sqrt(12.0))),
        )
        self.exposure_s = np.zeros((self.model.power_db.size, *self.grid.shape))
        """(h - 1, n_north, n_east): P(some robot hears) integrated over the time listened, for each fixed power."""
        self.candidates: list[Candidate] = []
        self.rate_prior_s = RATE_SHAPE / settings.reference_rate_hz
        self._open: dict[int, _Open] = {}
        self._unclaimed: dict[int, float] = {}
        self._explained: dict[int, float] = {}
        """Detection to the log of the intensity with which clutter and the candidates explain it."""
        self._next_detection = 0
        self._next_ident = 1
        self._summaries: dict[int, Summary] = {}
        self._revise_at: dict[int, float] = {}

    # -- evidence in -------------------------------------------------------------------------------------

    def listen(self, listening: Listening) -> None:
        """Add to the exposure of the ground, and of the candidates, where robots listened."""
        kernels.add_exposure(
            self.exposure_s,
            self.grid.cell_m,
            listening.position_m,
            self.model.hear,
            self.model.step2_m2,
            self.model.reach_outside_m,
            listening.duration_s,
        )

    def detect(self, detection: Detection) -> None:
        """Take in a transmission: attribute it, and look again at the attribution of the others near it."""
        number = self._next_detection
        self._next_detection += 1
        stored = self._store(detection)
        self._open[number] = stored
        self._unclaimed[number] = 1.0
        for candidate in self.candidates:
            if self._in_reach(candidate, stored):
                candidate.know(number, self.model.log_likelihood(detection, candidate.points_m))
        self._refresh()
        self._sweep(SWEEPS)
        for _ in range(2):
            if not self._birth():
                break
            self._sweep(SWEEPS)
        self._merge()
        self._bury()
        if self._revise():
            self._sweep(SWEEPS)
            self._merge()
            self._bury()
        self._fold()
        self._judge()

    def _store(self, detection: Detection) -> _Open:
        heard_at = detection.position_m[detection.heard]
        row0, row1, column0, column1 = self.grid.box_around(heard_at, self.model.reach_m)
        east, north = self.grid.east_m[column0:column1], self.grid.north_m[row0:row1]
        points = np.column_stack([np.tile(east, north.size), np.repeat(north, east.size)])
        log = self.model.log_likelihood(detection, points)[: self.model.n_known]
        scale = float(log.max())
        return _Open(detection, (row0, row1, column0, column1), np.exp(log - scale), scale, heard_at)

    def _in_reach(self, candidate: Candidate, stored: _Open) -> bool:
        low, high = candidate.points_m.min(axis=0), candidate.points_m.max(axis=0)
        gap = np.maximum(low - stored.near_m, 0.0) + np.maximum(stored.near_m - high, 0.0)
        return bool((np.hypot(gap[:, 0], gap[:, 1]) <= self.model.reach_m).all())

    # -- the mixture -------------------------------------------------------------------------------------

    def _refresh(self) -> None:
        """Bring the candidates' exposure up to date, from the cell each point lies in."""
        for candidate in self.candidates:
            candidate.exposure_s = self._exposure_at(candidate.points_m)

    def _exposure_at(self, points_m: FloatArray) -> FloatArray:
        """(h, n); the varying hypothesis takes the mean of the known levels."""
        column = np.clip((points_m[:, 0] / self.grid.cell_m).astype(int), 0, self.grid.n_east - 1)
        row = np.clip((points_m[:, 1] / self.grid.cell_m).astype(int), 0, self.grid.n_north - 1)
        fixed = self.exposure_s[:, row, column]
        return np.concatenate([fixed, fixed[: self.model.n_known].mean(axis=0)[None, :]])

    def _known_exposure_s(self) -> FloatArray:
        """(known levels, n_north, n_east)"""
        return self.exposure_s[: self.model.n_known]

    def _unknown_rate(self) -> FloatArray:
        """(n_north, n_east) expected transmissions per second and cell from sources not yet known."""
        exposure = self._known_exposure_s().mean(axis=0)
        here = self.settings.expected_sources / self.grid.n_cells
        b = self.rate_prior_s
        return here * (b / (b + exposure)) ** RATE_SHAPE * RATE_SHAPE / (b + exposure)

    def _log_unknown(self, stored: _Open, unknown_rate: FloatArray) -> float:
        row0, row1, column0, column1 = stored.box
        total = float((unknown_rate[row0:row1, column0:column1].ravel() * stored.like.mean(axis=0)).sum())
        return float(np.log(total + 1e-300)) + stored.log_scale

    def _sweep(self, sweeps: int) -> None:
        """Shares of all open detections, from the predictions of the candidates and of the unknown."""
        unknown_rate = self._unknown_rate()
        logs_unknown = {k: self._log_unknown(stored, unknown_rate) for k, stored in self._open.items()}
        for sweep in range(sweeps):
            # All but the last sweep look only at detections still in doubt or new.
            for number, stored in self._open.items():
                near = [c for c in self.candidates if number in c.logs]
                if not near:
                    self._unclaimed[number] = 1.0
                    self._explained[number] = _clutter(stored)
                    continue
                settled = any(c.share[number] > 0.999 for c in near) and sweep < sweeps - 1
                if settled:
                    continue
                terms = [logs_unknown[number], _clutter(stored)]
                for candidate in near:
                    log_posterior = candidate.log_posterior()
                    others = max(0.0, candidate.receptions - candidate.share[number])
                    rate = (RATE_SHAPE + others) / (self.rate_prior_s + self._exposure_mean(candidate))
                    terms.append(float(np.log(rate)) + candidate.log_predictive(number, log_posterior))
                shares = np.exp(np.array(terms) - logsumexp(terms))
                self._explained[number] = float(logsumexp(terms[1:]))
                for candidate, share in zip(near, shares[2:], strict=True):
                    candidate.set_share(number, float(share))
                self._unclaimed[number] = float(shares[0])
            for candidate in self.candidates:
                self._summaries.pop(candidate.ident, None)
        for candidate in self.candidates:
            candidate.prune()

    def _exposure_mean(self, candidate: Candidate) -> float:
        return self._summary(candidate).exposure_s

    def _summary(self, candidate: Candidate) -> Summary:
        if candidate.ident not in self._summaries:
            self._summaries[candidate.ident] = summarise(
                candidate, candidate.posterior(), self.model.power_db, self.model.outside, self.grid.cell_m
            )
        return self._summaries[candidate.ident]

    def another_source(self) -> FloatArray:
        """(known levels, n_north, n_east) expected number of sources of the reference rate not among the candidates.

        Prior times likelihood ratio: silence lowers it, detections that the candidates explain badly raise it. So
        it covers unsearched ground, unclaimed detections, and sources that hide behind a found neighbour.
        """
        ratio = np.empty((self.model.n_known, *self.grid.shape))
        stored = list(self._open.items())
        sizes = [s.like.shape[1] for _, s in stored]
        start = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
        stacked = (
            np.concatenate([s.like * np.exp(s.log_scale - self._explained[k]) for k, s in stored], axis=1)
            if stored
            else np.empty((self.model.n_known, 0))
        )
        boxes = np.array([s.box for _, s in stored], dtype=np.int64).reshape(-1, 4)
        kernels.another_source_llr(
            stacked, start[:-1], boxes, self.settings.reference_rate_hz, self._known_exposure_s(), ratio
        )
        prior = self.settings.expected_sources / self.grid.n_cells / self.model.n_known
        return np.asarray(prior * np.exp(np.minimum(ratio, 50.0)))

    def _birth(self) -> bool:
        """A candidate where one more source explains what was heard better than none; whether there was one."""
        expected = self.another_source()
        prior = self.settings.expected_sources / self.grid.n_cells / self.model.n_known
        telling = np.where(expected > prior, expected, 0.0)
        if telling.sum() < BIRTH_ODDS:
            return False
        place = telling.sum(axis=0)
        row, column = np.unravel_index(int(np.argmax(place)), place.shape)
        level = int(np.argmax(expected[:, row, column]))
        near = place > 1e-4 * place.max()
        reach = int(np.ceil(self.model.reach_m / self.grid.cell_m))
        rows = np.nonzero(near[max(0, row - reach) : row + reach + 1].any(axis=1))[0] + max(0, row - reach)
        columns = np.nonzero(near[:, max(0, column - reach) : column + reach + 1].any(axis=0))[0] + max(
            0, column - reach
        )
        candidate = self._new_candidate(
            (int(columns.min()), int(columns.max()) + 1), (int(rows.min()), int(rows.max()) + 1)
        )
        rate = self.settings.reference_rate_hz
        for number, stored in self._open.items():
            if not self._in_reach(candidate, stored):
                continue
            candidate.know(number, self.model.log_likelihood(stored.detection, candidate.points_m))
            row0, row1, column0, column1 = stored.box
            if row0 <= row < row1 and column0 <= column < column1:
                like = stored.like[level, (row - row0) * (column1 - column0) + column - column0]
                ratio = rate * like * np.exp(stored.log_scale - self._explained[number])
                candidate.set_share(number, float(ratio / (1.0 + ratio)))
        if candidate.receptions < DEATH_RECEPTIONS:
            return False
        for number, share in candidate.share.items():
            for other in self.candidates:
                if share > 0.0 and number in other.share:
                    other.set_share(number, other.share[number] * (1.0 - share))
        self._summaries.clear()
        self.candidates.append(candidate)
        return True

    def _new_candidate(self, columns: tuple[int, int], rows: tuple[int, int]) -> Candidate:
        cell = self.grid.cell_m
        fine = cell * FINE
        per_cell = round(1.0 / FINE)
        margin = 1
        east = np.arange(
            max(0, columns[0] - margin) * per_cell, min(self.grid.n_east, columns[1] + margin) * per_cell
        )
        north = np.arange(
            max(0, rows[0] - margin) * per_cell, min(self.grid.n_north, rows[1] + margin) * per_cell
        )
        points = np.column_stack(
            [np.tile((east + 0.5) * fine, north.size), np.repeat((north + 0.5) * fine, east.size)]
        )
        density = self.settings.expected_sources / self.grid.n_cells / per_cell**2
        prior = np.repeat(self.model.log_prior[:, None] + np.log(density), points.shape[0], axis=1)
        candidate = Candidate(self._next_ident, points, prior, self.rate_prior_s, self._exposure_at(points))
        self._next_ident += 1
        return candidate

    def _revise(self) -> bool:
        """Tell the story of a candidate afresh, as one source and as two; whether another story was better.

        Points dropped early and shares that vouch for each other can hold a candidate in a wrong place, or hold two
        near sources together. A doubtful candidate is looked at with every reception, others ever more rarely.
        """
        changed = False
        for candidate in list(self.candidates):
            due = self._revise_at.setdefault(candidate.ident, REVISE_AT)
            count = candidate.receptions
            if count < due:
                continue
            self._revise_at[candidate.ident] = count + 0.9 if candidate.state == "doubtful" else 1.4 * count
            if candidate.absorbed > 0.0:
                continue
            share = {number: share for number, share in candidate.share.items() if share > 0.05}
            stories = [[candidate], self._one(candidate, share), *self._two(candidate, share)]
            scores = [self._score(story, share) for story in stories]
            best = int(np.argmax(scores))
            if best == 0 or scores[best] < scores[0] + 1.0:
                continue
            self._remove(candidate)
            stories[best][0].ident = candidate.ident
            self.candidates += stories[best]
            for part in stories[best]:
                self._know_all(part)
            stories[best][0].state = candidate.state
            changed = True
        return changed

    def _know_all(self, candidate: Candidate) -> None:
        for number, other in self._open.items():
            if number not in candidate.logs and self._in_reach(candidate, other):
                candidate.know(number, self.model.log_likelihood(other.detection, candidate.points_m))

    def _fresh(self, candidate: Candidate, share: dict[int, float]) -> Candidate:
        """An empty candidate whose cloud covers wherever the given detections may have come from."""
        centre = self._summary(candidate).mean_m
        half = 0.75 * self.model.reach_m
        row0, row1, column0, column1 = self.grid.box_around(centre[None, :], half)
        fresh = self._new_candidate((column0, column1), (row0, row1))
        for number in share:
            fresh.know(number, self.model.log_likelihood(self._open[number].detection, fresh.points_m))
        return fresh

    def _one(self, candidate: Candidate, share: dict[int, float]) -> list[Candidate]:
        fresh = self._fresh(candidate, share)
        for number, part in share.items():
            fresh.set_share(number, part)
        fresh.prune()
        return [fresh]

    def _two(self, candidate: Candidate, share: dict[int, float]) -> list[list[Candidate]]:
        """Two sources, from first guesses that divide the detections across the line they spread on most."""
        blank = self._fresh(candidate, share)
        alone = []
        for log in blank.logs.values():
            weight = np.exp(self.model.marginal(log))
            alone.append((weight / weight.sum()) @ blank.points_m)
        spread = np.array(alone) - np.mean(alone, axis=0)
        axis = np.linalg.svd(spread, full_matrices=False)[2][0]
        stories = []
        for turn_rad in (0.0, np.pi / 3, -np.pi / 3):
            across = np.array([np.cos(turn_rad) * axis[0] - np.sin(turn_rad) * axis[1],
                               np.sin(turn_rad) * axis[0] + np.cos(turn_rad) * axis[1]])  # fmt: skip
            along = spread @ across
            order = np.argsort(np.argsort(along, kind="stable"), kind="stable")
            pair = self._divide(blank, share, order * 2 < len(share))
            if min(part.receptions for part in pair) >= 1.0:
                stories.append(pair)
        return stories

    def _divide(self, blank: Candidate, share: dict[int, float], lean: NDArray[np.bool_]) -> list[Candidate]:
        """Two candidates that settle between them who sent what, from a first guess."""
        pair = [copy.copy(blank), copy.copy(blank)]
        for part in pair:
            part.logs, part.share, part.evidence = dict(blank.logs), dict(blank.share), blank.evidence.copy()
        pair[1].ident = self._next_ident
        self._next_ident += 1
        for first_more, (number, whole) in zip(lean, share.items(), strict=True):
            first = 0.9 if first_more else 0.1
            pair[0].set_share(number, first * whole)
            pair[1].set_share(number, (1.0 - first) * whole)
        for _ in range(8):
            for part in pair:
                part.prune()
            logs = [part.log_posterior() for part in pair]
            exposure = [part.mean_exposure_s(part.posterior()) for part in pair]
            moved = 0.0
            for number, whole in share.items():
                terms = np.array(
                    [
                        np.log(
                            (RATE_SHAPE + max(0.0, c.receptions - c.share[number]))
                            / (self.rate_prior_s + seen)
                        )
                        + c.log_predictive(number, log)
                        for c, log, seen in zip(pair, logs, exposure, strict=True)
                    ]
                )
                shares = whole * np.exp(terms - logsumexp(terms))
                for index, part in enumerate(pair):
                    change = float(shares[index]) - part.share[number]
                    moved += abs(change)
                    part.set_share(number, float(shares[index]))
                    logs[index] = logs[index] + change * part.logs[number]
            if moved < 0.05:
                break
        return pair

    def _score(self, story: list[Candidate], share: dict[int, float]) -> float:
        """Lower bound of the log evidence of a story that shares out the same detections."""
        total = sum(candidate.log_evidence() for candidate in story)
        for number, part in share.items():
            parts = np.array([candidate.share.get(number, 0.0) for candidate in story]) / part
            total -= part * float((parts * np.log(np.maximum(parts, 1e-12))).sum())
        return total

    def _merge(self) -> None:
        """Let one candidate speak for two where that explains better what both sent."""
        done = False
        while not done:
            done = True
            for first in self.candidates:
                for second in self.candidates:
                    if first.ident >= second.ident or not self._close(first, second):
                        continue
                    keep, drop = (first, second) if first.receptions >= second.receptions else (second, first)
                    gain = merged_gain(keep, drop)
                    if gain == -np.inf:
                        keep, drop = drop, keep
                        gain = merged_gain(keep, drop)
                    if gain > 0.0:
                        for number, share in drop.share.items():
                            if number in keep.share and share > 0.0:
                                keep.set_share(number, min(1.0, keep.share[number] + share))
                        self._remove(drop)
                        self._summaries.pop(keep.ident, None)
                        done = False
                        break
                if not done:
                    break
        if self.candidates:
            self._sweep(1)

    def _close(self, first: Candidate, second: Candidate) -> bool:
        a, b = self._summary(first), self._summary(second)
        spread = np.sqrt(np.trace(a.cov_m2)) + np.sqrt(np.trace(b.cov_m2))
        return float(np.hypot(*(a.mean_m - b.mean_m))) < 3.0 * self.grid.cell_m + 2.0 * spread

    def _remove(self, candidate: Candidate) -> None:
        self.candidates = [c for c in self.candidates if c is not candidate]
        self._summaries.pop(candidate.ident, None)

    def _bury(self) -> None:
        """Drop candidates that nothing supports any more; what they held is unclaimed again."""
        for candidate in [c for c in self.candidates if c.receptions < DEATH_RECEPTIONS]:
            for number, share in candidate.share.items():
                self._unclaimed[number] = min(1.0, self._unclaimed[number] + share)
            self._remove(candidate)

    def _fold(self) -> None:
        """Close the oldest detections beyond `MAX_OPEN`."""
        while len(self._open) > MAX_OPEN:
            oldest = next(iter(self._open))
            for candidate in self.candidates:
                candidate.forget(oldest)
            del self._open[oldest], self._unclaimed[oldest], self._explained[oldest]

    # -- what may be said --------------------------------------------------------------------------------

    def _judge(self) -> None:
        """Candidate, found or doubtful; a find that later evidence takes back says why."""
        threshold = self.settings.found_probability
        for candidate in self.candidates:
            summary = self._summary(candidate)
            enough = candidate.receptions >= self.settings.min_receptions - 0.1
            placed = summary.p_here >= (threshold if candidate.state != "found" else WITHDRAW * threshold)
            if not (enough and placed):
                candidate.certain_since = None
                if candidate.state == "found":
                    candidate.note = f"withdrawn: probability of being here fell to {summary.p_here:.2f}"
                candidate.state = "candidate"
                continue
            if candidate.state == "candidate" and self._fresh_evidence(candidate):
                continue
            doubt = self._doubt(candidate, summary)
            candidate.state = "doubtful" if doubt else "found"
            candidate.note = doubt

    def _fresh_evidence(self, candidate: Candidate) -> bool:
        """Whether this is the first look at which the place is certain enough: a find must outlast one reception.

        The moment a probability first crosses a threshold is picked for being high; one more independent reception
        that leaves it there is worth more than a higher threshold.
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
        if count >= 5 and misfit > MAX_SQUARED_RESIDUAL:
            return (
                f"the model does not explain these readings: residuals are {np.sqrt(misfit):.1f} times as wide as "
                f"the antenna file's sigma of {self.settings.antenna.sigma_db:.1f} dB ({count} readings)"
            )
        return ""

    def _misfit(self, candidate: Candidate) -> tuple[float, int]:
        """Mean squared standardised residual of the readings it claims, at the most probable place and power."""
        log = candidate.log_posterior()[:-1]
        level, index = np.unravel_index(int(np.argmax(log)), log.shape)
        place = candidate.points_m[index]
        squares = []
        for number, share in candidate.share.items():
            if share < 0.5:
                continue
            detection = self._open[number].detection
            use = detection.heard & ~detection.saturated
            distance = np.hypot(*(detection.position_m[use] - place).T)
            mean = self.settings.antenna.mean_rss_dbm(distance, self.model.power_db[level])
            residual = (detection.rss_dbm[use] - mean) / self.model.spread_db(distance)
            squares.extend(np.minimum(residual**2, 12.0))  # one outlier is no misfit
        return (float(np.mean(squares)), len(squares)) if squares else (0.0, 0)

    def sources(self) -> list[SourceEstimate]:
        """Candidates with at least one reception, by identity."""
        estimates = []
        for candidate in self.candidates:
            summary = self._summary(candidate)
            estimates.append(
                SourceEstimate(
                    ident=candidate.ident,
                    east_m=float(summary.mean_m[0]),
                    north_m=float(summary.mean_m[1]),
                    cov_m2=summary.cov_m2,
                    region_90=self._region_90(candidate),
                    receptions=candidate.receptions,
                    rate_hz=(RATE_SHAPE + candidate.receptions) / (self.rate_prior_s + summary.exposure_s),
                    p_exists=1.0
                    - float(np.prod([1.0 - min(share, 1.0 - 1e-9) for share in candidate.share.values()])),
                    p_here=summary.p_here,
                    state=candidate.state,  # type: ignore[arg-type]
                    note=candidate.note,
                    power_db=summary.power_db,
                )
            )
        return estimates

    def _cells_of(self, candidate: Candidate) -> tuple[FloatArray, FloatArray]:
        """Flat cell indices and the posterior of each."""
        place = candidate.posterior().sum(axis=0)
        column = np.clip((candidate.points_m[:, 0] / self.grid.cell_m).astype(int), 0, self.grid.n_east - 1)
        row = np.clip((candidate.points_m[:, 1] / self.grid.cell_m).astype(int), 0, self.grid.n_north - 1)
        flat = row * self.grid.n_east + column
        cells = np.unique(flat)
        return cells, np.bincount(np.searchsorted(cells, flat), weights=place)

    def region_90(self, candidate: Candidate) -> set[tuple[int, int]]:
        """The cells of the smallest region that holds 90 % of the location posterior."""
        cells, place = self._cells_of(candidate)
        order = np.argsort(-place, kind="stable")
        needed = int(np.searchsorted(np.cumsum(place[order]), 0.9)) + 1
        return {(int(c) // self.grid.n_east, int(c) % self.grid.n_east) for c in cells[order[:needed]]}

    def _region_90(self, candidate: Candidate) -> int:
        return len(self.region_90(candidate))

    def presence(self) -> FloatArray:
        """(n_north, n_east) probability that the cell holds a source, heard or not."""
        b = self.rate_prior_s
        unseen = (self.settings.expected_sources / self.grid.n_cells) * (
            b / (b + self._known_exposure_s().mean(axis=0))
        )
        log_absent = np.log1p(-np.minimum(unseen, 0.999)).ravel()
        for candidate in self.candidates:
            cells, place = self._cells_of(candidate)
            log_absent[cells] += np.log1p(-np.minimum(place * min(1.0, candidate.receptions), 1.0 - 1e-9))
        return (1.0 - np.exp(log_absent)).reshape(self.grid.shape)

    def activity(self) -> FloatArray:
        """(n_north, n_east), sums to 1: expected rate of transmissions by cell."""
        rate = self._unknown_rate().ravel()
        for candidate in self.candidates:
            cells, place = self._cells_of(candidate)
            hz = (RATE_SHAPE + candidate.receptions) / (self.rate_prior_s + self._exposure_mean(candidate))
            rate[cells] += place * hz
        return (rate / rate.sum()).reshape(self.grid.shape)

    def probability_left(self) -> float:
        """P(at least one source of the reference rate not found): unheard ground, and candidates not yet found."""
        none_left = float(np.exp(-self.another_source().sum()))
        for candidate in self.candidates:
            if candidate.state != "found":
                none_left *= 1.0 - min(1.0, candidate.receptions)
        return float(1.0 - none_left)

    # -- for planners ------------------------------------------------------------------------------------

    def ground_value(self) -> FloatArray:
        """(n_north, n_east) expected number of sources of the reference rate that are not among the candidates."""
        return np.minimum(self.another_source().sum(axis=0), 0.5)

    def unresolved(self, samples: int, rng: np.random.Generator) -> list[Unresolved]:
        """Candidates that are not found, each with samples of place and power from its posterior."""
        result = []
        for candidate in self.candidates:
            if candidate.state == "found":
                continue
            posterior = candidate.posterior()
            picks = rng.choice(posterior.size, size=samples, p=posterior.ravel() / posterior.sum())
            hypothesis, point = np.divmod(picks, posterior.shape[1])
            level = np.where(hypothesis < self.model.power_db.size, hypothesis, self.model.n_known // 2)
            summary = self._summary(candidate)
            result.append(
                Unresolved(
                    candidate.ident,
                    candidate.points_m[point].copy(),
                    level.astype(float),
                    summary.cov_m2,
                    (RATE_SHAPE + candidate.receptions) / (self.rate_prior_s + summary.exposure_s),
                    candidate.receptions,
                    summary.p_here,
                    candidate.state,
                )
            )
        return result

    def digest(self) -> bytes:
        """SHA-256 over exposure and every candidate's cloud, evidence and shares."""
        state = hashlib.sha256(self.exposure_s.tobytes())
        for candidate in self.candidates:
            state.update(f"{candidate.ident} {candidate.state} {candidate.absorbed!r}".encode())
            state.update(candidate.points_m.tobytes())
            state.update(candidate.evidence.tobytes())
            state.update(repr(sorted(candidate.share.items())).encode())
        return state.digest()
