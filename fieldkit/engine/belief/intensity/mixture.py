"""The mixture under the default belief: who sent what, among the candidates, one not yet known, and clutter.

Shares are set by what the *other* detections of a candidate predict (collapsed variational mixture, zeroth order),
so that a reading does not vouch for itself. One more candidate is born where one more source would explain the
detections better than those there are; two become one where one explains better what both sent; one that nothing
supports any more is dropped. `hypotheses` re-tells the history of a candidate that may be stuck.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fieldkit.channel.antenna_file import Receiver
from fieldkit.engine.belief.intensity import hypotheses as hypotheses
from fieldkit.engine.belief.intensity import loops
from fieldkit.engine.belief.intensity.arena import Arena, Row, starts
from fieldkit.engine.belief.intensity.births import birth, new_candidate, refine, remember_births
from fieldkit.engine.belief.intensity.candidate import Candidate, Summary, summarise
from fieldkit.engine.belief.intensity.ground import ground_of
from fieldkit.engine.belief.intensity.merging import merge
from fieldkit.engine.belief.intensity.responsibilities import Shares, share_out
from fieldkit.engine.belief.intensity.silence import note_heard
from fieldkit.engine.belief.intensity.watch import Watch
from fieldkit.engine.likelihood import levels_loops
from fieldkit.engine.likelihood.ears import Ears
from fieldkit.engine.likelihood.ears_loops import NORTH, UP
from fieldkit.engine.likelihood.levels import LevelsModel
from fieldkit.engine.likelihood.places import NOTHING_EARLIER, Earlier, PlaceNoise, levels_of, redundancy
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Detection, FloatArray, Listening, part_of

SHARED_NS = 120_000_000_000
"""Positions err together for so long: twice the time in which such an error falls to 1/e."""
WATCHED_FROM = 5.0
"""Receptions from which on a candidate is known well enough to measure receivers by."""


@dataclass(frozen=True, slots=True, eq=False)
class OpenDetection:
    """A stored detection: its likelihood over the cells near it, scaled to a maximum of 1."""

    detection: Detection
    box: tuple[int, int, int, int]
    like: Row
    """(known levels, cells of the box, row by row)"""
    mean_like: Row
    """(rows, columns) of the box: the same averaged over the levels."""
    log_scale: float
    log_clutter: float
    """log intensity with which noise explains it: any strength within 80 dB."""
    near_m: FloatArray
    """(k, 2) where it was heard."""
    ears: FloatArray
    """(k, columns) by whom, as the likelihood sees them."""
    rss_dbm: FloatArray
    """(k,) how strongly; nan where at the receiver's ceiling."""


class Mixture:
    """Candidates, open detections and exposure. Deterministic: same calls, same bits."""

    def __init__(self, settings: EngineSettings) -> None:
        self.settings, self.tuning = settings, settings.tuning.intensity
        self.field = settings.grid
        self.ground = ground_of(settings, self.tuning.ground_cells)
        self.grid = self.ground.grid
        point_sigma_m = self.tuning.fine_cells * settings.grid.cell_m / np.sqrt(12.0)
        self.ears = Ears(
            settings.antenna,
            settings.source_up_m,
            settings.spread.elevation if settings.spread is not None else 0.0,
            settings.receivers,
            float(point_sigma_m),
            settings.pose_sigma_m,
        )
        self.model = LevelsModel(
            settings.antenna,
            levels_of(settings.power_levels_db, settings.spread),
            float(np.hypot(settings.pose_sigma_m, point_sigma_m)),
            settings.tuning.likelihood,
            self.ears,
        )
        self.exposure_s = np.zeros((self.model.power_db.size, *self.grid.shape))
        """(h - 1, rows, columns of the ground): P(some robot hears) integrated over the time listened, by power."""
        self._cell_ears = replace(self.ears, point_sigma_m=float(point_sigma_m * self.ground.factor))
        """As the ears, for likelihoods over the ground's cells."""
        self.places = (
            PlaceNoise(self.model, settings.spread, settings.reference_rate_hz)
            if settings.spread is not None and settings.place_noise
            else None
        )
        """What readings and silence of one place have in common; None where nothing."""
        self.rate_prior_s = self.tuning.rate_shape / settings.reference_rate_hz
        """b of the Gamma prior of a source's rate."""
        self.candidates: list[Candidate] = []
        self.open: dict[int, OpenDetection] = {}
        self.unclaimed: dict[int, float] = {}
        """Detection to the probability that a source not yet known sent it."""
        self.explained: dict[int, float] = {}
        """Detection to the log of the intensity with which clutter and the candidates explain it."""
        self.revise_at: dict[int, float] = {}
        """Candidate to the receptions at which its hypothesis is next told afresh."""
        self.born: dict[int, tuple[tuple[float, float], float]] = {}
        """Candidates born at this detection, where, and at what odds."""
        self.stillborn: list[tuple[tuple[float, float], float]] = []
        """The same of those that did not last."""
        self.merge_at: dict[tuple[int, int], float] = {}
        """Neighbours to the receptions of both at which it is next asked whether they are one."""
        self.arena = Arena()
        """What candidates know of detections."""
        self._open_arena = Arena()
        """Likelihoods of the open detections over the grid."""
        self.watch = Watch()
        """Receivers against each other."""
        self.named: set[int] = set()
        """Open detections whose sender is known."""
        self._nameless = False
        self.said: list[str] = []
        """What there is to say of them, until somebody has read it."""
        self.now_ns = 0
        """Up to when something was heard, or listened to."""
        self._since_ns: int | None = None
        self._clutter_folded = 0.0
        self._next_detection = 0
        self._next_ident = 1
        self._summaries: dict[int, Summary] = {}

    def listen(self, listening: Listening) -> None:
        """Add to the exposure of the ground where robots listened."""
        self.now_ns = max(self.now_ns, listening.t1_ns)
        self._since_ns = listening.t0_ns if self._since_ns is None else min(self._since_ns, listening.t0_ns)
        hearing = [not self._is_deaf(robot) for robot in listening.robots]
        if not any(hearing):
            return
        ears = self.ears.of_listening(listening)[hearing]
        ears[:, : NORTH + 1] -= self.grid.west_m, self.grid.south_m  # loops count cells from their own corner
        if self.places is not None:
            self.places.listen(self.exposure_s, self.grid.cell_m, ears, listening.duration_s)
            return
        model = self.model
        if not self.ears.receivers and not self.settings.antenna.pattern_db and not ears[:, UP].any():
            levels_loops.add_exposure(
                self.exposure_s,
                self.grid.cell_m,
                np.ascontiguousarray(ears[:, : NORTH + 1]),
                model.hear,
                model.step2_m2,
                model.limit2_m2,
                listening.duration_s,
            )
            return
        levels_loops.add_exposure_of_ears(
            self.exposure_s,
            self.grid.cell_m,
            ears,
            np.zeros(len(ears), dtype=np.int64),
            model.hear[None],
            model.step2_m2,
            model.limit2_m2,
            model.antenna.threshold_dbm,
            self.ears.law,
            self.ears.pattern_db,
            self.ears.best_db,
            listening.duration_s,
        )

    def detect(self, detections: Sequence[Detection]) -> None:
        """Take in transmissions: attribute them, and look again at the attribution of the others near them."""
        for detection in detections:
            self.now_ns = max(self.now_ns, detection.t_ns)
            self._open(detection)
        for candidate in self.candidates:
            candidate.rate_trust = self._rate_trust(candidate)
            candidate.expose(self.exposure_at(candidate.points_m))
        self.sweep(self.tuning.sweeps)
        for _ in range(1 + len(detections)):
            if not birth(self):
                break
            self.sweep(self.tuning.sweeps)
        self._settle()
        remember_births(self)
        self._watch(detections)
        for candidate in self.candidates:
            note_heard(self, candidate)
        self._fold()

    def _is_deaf(self, robot: str) -> bool:
        return robot in self.watch.of and self.watch.of[robot].deaf

    def _without_deaf(self, detection: Detection) -> Detection:
        """The detection without robots whose silence says nothing."""
        keep = ~np.isnan(detection.rss_dbm) | np.array([not self._is_deaf(r) for r in detection.robots])
        return detection if keep.all() else part_of(detection, keep)

    def _watch(self, detections: Sequence[Detection]) -> None:
        """Measure receivers by what has just been heard of sources that are well known."""
        for number, detection in zip(list(self.open)[-len(detections) :], detections, strict=False):
            for candidate in self.candidates:
                known = candidate.receptions >= WATCHED_FROM and self.summary(candidate).p_here >= 0.5
                if known and candidate.share.get(number, 0.0) >= 0.9:
                    self.watch.take_in(self, self.ears.corrected(detection), candidate)
        before = {robot: its.offset_db for robot, its in self.watch.of.items()}
        self.said += [*self.watch.judge(self.settings.antenna.sigma_db), *self.watch.common(self)]
        learnt = {robot: its.offset_db for robot, its in self.watch.of.items() if its.offset_db != 0.0}
        if learnt and learnt != {robot: offset for robot, offset in before.items() if offset != 0.0}:
            self._correct(learnt)

    def _correct(self, learnt: dict[str, float]) -> None:
        """Take what was learnt off further readings; those that are in already stay as they are."""
        receivers = dict(self.settings.receivers)
        for robot, offset_db in learnt.items():
            own = receivers.get(robot, Receiver())
            receivers[robot] = replace(own, offset_db=own.offset_db + offset_db)
        self.ears = replace(self.ears, receivers=receivers)
        self._cell_ears = replace(self._cell_ears, receivers=receivers)
        self.model.ears = self.ears

    def reflect(self) -> bool | None:
        """Tell the hypothesis of one candidate afresh; whether another was better, None where none was due."""
        better = hypotheses.revise(self)
        if better:
            self.sweep(self.tuning.sweeps)
            self._settle()
        return better

    def _open(self, detection: Detection) -> None:
        number = self._next_detection
        self._next_detection += 1
        stored = self._store(self._without_deaf(self.ears.corrected(detection)))
        self.open[number] = stored
        self.unclaimed[number], self.explained[number] = 1.0, stored.log_clutter
        if self.settings.identity == "address" and detection.sender is not None:
            self._claim_by_name(number, stored, detection.sender)
            return
        if self.settings.identity == "address" and not self._nameless:
            self._nameless = True
            self.said.append(
                "sources.identity is 'address', and frames come in that name no sender: those are told apart by "
                "where they are heard, as anonymous ones"
            )
        for candidate in self.candidates:
            if not candidate.name and self.in_reach(candidate, stored):
                candidate.know(number, self.log_likelihood(candidate, number))

    def _claim_by_name(self, number: int, stored: OpenDetection, name: str) -> None:
        """A detection that names its sender belongs to that sender, who may be new, for certain."""
        sender = next((each for each in self.candidates if each.name == name), None)
        if sender is None:
            row0, row1, column0, column1 = stored.box
            sender = new_candidate(self, (column0, column1), (row0, row1), spacing=1.0)
            sender.name = name
            self.candidates.append(sender)
        sender.know(number, self.log_likelihood(sender, number))
        sender.set_share(number, 1.0)
        self.unclaimed[number] = 0.0
        self.explained[number] = 50.0  # nobody else needs to explain it
        self.named.add(number)
        self._summaries.pop(sender.ident, None)

    def log_likelihood(self, candidate: Candidate, number: int) -> FloatArray:
        """(h, n) of an open detection over the candidate's points, given what it claims to have sent before."""
        detection = self.open[number].detection
        if self.places is None:
            return self.model.log_likelihood(detection, candidate.points_m)
        claimed = [
            other
            for other, share in candidate.share.items()
            if share >= self.tuning.claimed and other < number and other in self.open
        ]
        candidate.based_on[number] = claimed
        own = [self.open[other] for other in claimed]
        if not own:
            return self.places.log_likelihood(detection, candidate.points_m, NOTHING_EARLIER)
        ears, rss = (
            np.concatenate([each.ears for each in own]),
            np.concatenate([each.rss_dbm for each in own]),
        )
        use = ~np.isnan(rss)
        return self.places.log_likelihood(detection, candidate.points_m, Earlier(ears[use], rss[use]))

    def next_ident(self) -> int:
        """An identity no candidate has had."""
        self._next_ident += 1
        return self._next_ident - 1

    def _rate_trust(self, candidate: Candidate) -> float:
        """Mean worth of what it claims beside its neighbours; 1 without place noise."""
        if self.places is None or self.settings.spread is None:
            return 1.0
        own = [
            self.open[number].near_m
            for number, share in candidate.share.items()
            if share >= self.tuning.claimed and number in self.open
        ]
        return float(redundancy(own, self.settings.spread).mean()) if own else 1.0

    def _condition(self) -> None:
        """Tell anew what rests on detections that a candidate no longer claims, or lacks one that it does now."""
        for candidate in self.candidates:
            if self.tell_given_each_other(candidate):
                self._summaries.pop(candidate.ident, None)

    def tell_given_each_other(self, candidate: Candidate) -> bool:
        """Each detection of a candidate given those it claims before it; whether any had to be told anew."""
        told = False
        for number, share in candidate.share.items():
            if share < 0.05 or number not in self.open:
                continue
            claimed = [
                other
                for other, part in candidate.share.items()
                if part >= self.tuning.claimed and other < number and other in self.open
            ]
            if claimed == candidate.based_on.get(number):
                continue
            old = candidate.logs[number].array
            candidate.know(number, self.log_likelihood(candidate, number))
            candidate.evidence += share * (candidate.logs[number].array - old)
            told = True
        return told

    def _settle(self) -> None:
        if self.places is not None:
            self._condition()
        if merge(self):
            self.sweep(1)
        self._bury()

    def _store(self, detection: Detection) -> OpenDetection:
        heard_at = detection.position_m[detection.heard]
        row0, row1, column0, column1 = self.grid.box_around(heard_at, self.model.reach_m)
        east, north = self.grid.east_m[column0:column1], self.grid.north_m[row0:row1]
        points = np.column_stack([np.tile(east, north.size), np.repeat(north, east.size)])
        log = self.model.known_log_likelihood(detection, points, self._cell_ears)
        scale = float(log.max())
        like = np.exp(log - scale)
        clutter = float(np.log(self.tuning.clutter_hz) - len(heard_at) * np.log(80.0))
        mean = like.mean(axis=0).reshape(north.size, east.size)
        return OpenDetection(
            detection,
            (row0, row1, column0, column1),
            self._open_arena.put(like),
            self._open_arena.put(mean),
            scale,
            clutter,
            heard_at,
            self.ears.of_detection(detection)[detection.heard],
            np.where(detection.saturated, np.nan, detection.rss_dbm)[detection.heard],
        )

    def in_reach(self, candidate: Candidate, stored: OpenDetection) -> bool:
        """Whether the candidate may have been what was heard, by distance alone."""
        low, high = candidate.points_m.min(axis=0), candidate.points_m.max(axis=0)
        gap = np.maximum(low - stored.near_m, 0.0) + np.maximum(stored.near_m - high, 0.0)
        return bool((np.hypot(gap[:, 0], gap[:, 1]) <= self.model.reach_m).all())

    def exposure_at(self, points_m: FloatArray) -> FloatArray:
        """(h, n); the varying hypothesis takes the mean of the known levels."""
        at = (points_m - (self.grid.west_m, self.grid.south_m)) / self.grid.cell_m
        column = np.clip(at[:, 0].astype(int), 0, self.grid.n_east - 1)
        row = np.clip(at[:, 1].astype(int), 0, self.grid.n_north - 1)
        fixed = self.exposure_s[:, row, column]
        return np.concatenate([fixed, fixed[: self.model.n_known].mean(axis=0)[None, :]])

    def known_exposure_s(self) -> FloatArray:
        """(known levels, n_north, n_east)"""
        return self.exposure_s[: self.model.n_known]

    def unknown_rate(self) -> FloatArray:
        """(n_north, n_east) expected transmissions per second and cell from sources not yet known."""
        exposure = self.known_exposure_s().mean(axis=0)
        here = self.settings.expected_sources * self.ground.sources_a_cell
        b = self.rate_prior_s
        result: FloatArray = (
            here * (b / (b + exposure)) ** self.tuning.rate_shape * self.tuning.rate_shape / (b + exposure)
        )
        return result

    def _log_unknown(self) -> FloatArray:
        """(detections that name nobody,) log intensity with which sources not yet known explain each."""
        stored = [each for number, each in self.open.items() if number not in self.named]
        logs = np.empty(len(stored))
        loops.log_expected(
            self._open_arena.values,
            starts([s.mean_like for s in stored]),
            np.array([s.box for s in stored], dtype=np.int64).reshape(-1, 4),
            self.unknown_rate(),
            logs,
        )
        result: FloatArray = logs + np.array([s.log_scale for s in stored])
        return result

    def _learnt_clutter(self) -> float:
        """log of how much more clutter there is than was expected, by what neither a candidate nor the unknown claims.

        Gamma with the expected rate as its mean and one detection's weight; never less than was expected.
        """
        claimed = dict.fromkeys(self.open, 0.0)
        for candidate in self.candidates:
            for number, share in candidate.share.items():
                if number in claimed:
                    claimed[number] += share
        count = self._clutter_folded + math.fsum(
            max(0.0, 1.0 - self.unclaimed[number] - share) for number, share in claimed.items()
        )
        prior_s = 1.0 / self.tuning.clutter_hz
        listened_s = max(0.0, (self.now_ns - self._since_ns) * 1e-9) if self._since_ns is not None else 0.0
        learnt_hz = (1.0 + count) / (prior_s + listened_s)
        return max(0.0, math.log(learnt_hz / self.tuning.clutter_hz))

    def sweep(self, sweeps: int) -> None:
        """Shares of all open detections, from the predictions of the candidates and of the unknown.

        All but the last sweep look only at detections still in doubt or new.
        """
        numbers = [number for number in self.open if number not in self.named]
        log_unknown = self._log_unknown()
        more = self._learnt_clutter()
        log_clutter = np.array([self.open[number].log_clutter + more for number in numbers])
        left = Shares(
            np.array([self.unclaimed[number] for number in numbers]),
            np.array([self.explained[number] for number in numbers]),
        )

        def mean_exposure_s() -> FloatArray:
            seen = np.array([self.summary(candidate).exposure_s for candidate in self.candidates])
            self._summaries.clear()
            return seen

        share_out(
            self.arena,
            self.candidates,
            numbers,
            log_unknown,
            log_clutter,
            mean_exposure_s,
            self.tuning.rate_shape,
            self.rate_prior_s,
            left,
            passes=sweeps,
        )
        self.unclaimed.update(zip(numbers, left.unclaimed.tolist(), strict=True))
        self.explained.update(zip(numbers, left.explained.tolist(), strict=True))
        for candidate in self.candidates:
            candidate.prune()
            coarse = candidate.spacing_m > 1.01 * self.tuning.fine_cells * self.field.cell_m
            if coarse and candidate.points_m.shape[0] <= self.tuning.refine_points:
                refine(self, candidate)
                self._summaries.pop(candidate.ident, None)

    def summary(self, candidate: Candidate) -> Summary:
        """The candidate's posterior in a few numbers, kept until it changes."""
        if candidate.ident not in self._summaries:
            self._summaries[candidate.ident] = summarise(
                candidate,
                candidate.posterior(),
                self.model.power_db,
                self.model.outside,
                self.field.cell_m,
                self.settings.find_radius_m,
                self.ground.has_field(candidate.points_m),
                self._shared_sigma_m(candidate),
            )
        return self._summaries[candidate.ident]

    def _shared_sigma_m(self, candidate: Candidate) -> float:
        """How far the positions that told of it may be off together.

        Errors of satellites last about a minute: readings nearer in time share one. Readings made nearer to the source
        tell more of its place, by the Fisher information of a distance: a few of them may be all that counts.
        """
        own = [
            self.open[number]
            for number, share in candidate.share.items()
            if share >= self.tuning.claimed and number in self.open
        ]
        if not own:
            return self.settings.pose_sigma_m
        sigmas = [
            float(each.detection.sigma_m.mean()) if each.detection.sigma_m.size else 0.0 for each in own
        ]
        sigma_m = max(self.settings.pose_sigma_m, float(np.mean(sigmas)))
        middle = candidate.points_m[int(candidate.log_posterior().max(axis=0).argmax())]
        told: dict[int, float] = {}
        for each in own:
            far2 = float(((each.near_m - middle) ** 2).sum(axis=1).min()) + sigma_m**2 + self.field.cell_m**2
            block = each.detection.t_ns // SHARED_NS
            told[block] = told.get(block, 0.0) + 1.0 / far2
        weight = np.array(list(told.values()))
        return float(sigma_m * np.sqrt((weight**2).sum()) / weight.sum())

    def another_source(self, rate_hz: float | None = None) -> FloatArray:
        """(known levels, n_north, n_east) expected number of sources of this rate not among the candidates.

        Prior times likelihood ratio: silence lowers it, detections that the candidates explain badly raise it. So
        it covers unsearched ground, unclaimed detections, and sources that hide behind a found neighbour.
        """
        rate_hz = rate_hz or self.settings.reference_rate_hz
        ratio = np.empty((self.model.n_known, *self.grid.shape))
        stored = self.open.values()
        scale = np.array([s.log_scale for s in stored]) - np.array([self.explained[k] for k in self.open])
        loops.another_source_llr(
            self._open_arena.values,
            starts([s.like for s in stored]),
            np.array([s.box for s in stored], dtype=np.int64).reshape(-1, 4),
            rate_hz * np.exp(scale),
            self.known_exposure_s(),
            rate_hz,
            ratio,
        )
        prior = self.settings.expected_sources * self.ground.sources_a_cell / self.model.n_known
        return np.asarray(prior * np.exp(np.minimum(ratio, 50.0)))

    def forget_summary(self, candidate: Candidate) -> None:
        """It has changed: what it comes to is to be looked at anew."""
        self._summaries.pop(candidate.ident, None)

    def forget_summaries(self) -> None:
        """All have changed."""
        self._summaries.clear()

    def remove(self, candidate: Candidate) -> None:
        """Drop a candidate; its detections are for others to claim."""
        self.candidates = [c for c in self.candidates if c is not candidate]
        self._summaries.pop(candidate.ident, None)

    def _bury(self) -> None:
        """Drop candidates that nothing supports any more; what they held is unclaimed again."""
        for candidate in [c for c in self.candidates if c.receptions < self.tuning.death_receptions]:
            for number, share in candidate.share.items():
                self.unclaimed[number] = min(1.0, self.unclaimed[number] + share)
            self.remove(candidate)

    def _fold(self) -> None:
        """Close old detections beyond `max_open`: of sources that have many, so that no rare one is forgotten."""
        while len(self.open) > self.tuning.max_open:
            number = self._to_fold()
            share = math.fsum(candidate.share.get(number, 0.0) for candidate in self.candidates)
            self._clutter_folded += max(0.0, 1.0 - self.unclaimed[number] - share)
            for candidate in self.candidates:
                candidate.forget(number)
            self.named.discard(number)
            del self.open[number], self.unclaimed[number], self.explained[number]

    def _to_fold(self) -> int:
        """The oldest detection of whoever has most of the open ones, be that nobody."""
        owner = {
            number: max(self.candidates, key=lambda c: c.share.get(number, 0.0), default=None)
            for number in self.open
        }
        of: dict[int, list[int]] = {}
        for number, candidate in owner.items():
            claimed = candidate is not None and candidate.share.get(number, 0.0) >= self.tuning.claimed
            of.setdefault(candidate.ident if claimed and candidate is not None else 0, []).append(number)
        return max(of.values(), key=len)[0]
