"""The mixture under the default belief: who sent what, among the candidates, one not yet known, and clutter.

Attribution are set by what the *other* detections of a candidate predict (collapsed variational mixture, zeroth order),
so that a reading does not vouch for itself. One more candidate is born where one more source would explain the
detections better than those there are; two become one where one explains better what both sent; one that nothing
supports any more is dropped. `hypotheses` re-estimates a candidate that may be stuck from its detections.
"""

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fieldkit.channel.spread import assumed
from fieldkit.engine.belief.intensity import births, hypotheses
from fieldkit.engine.belief.intensity.arena import Arena, Row
from fieldkit.engine.belief.intensity.candidate import Candidate, Summary, summarise
from fieldkit.engine.belief.intensity.freezing import freeze
from fieldkit.engine.belief.intensity.ground import ground_of
from fieldkit.engine.belief.intensity.merging import merge
from fieldkit.engine.belief.intensity.nuisance import shared_sigma_m
from fieldkit.engine.belief.intensity.passes import concerned, shares_of, sweep, sweep_again
from fieldkit.engine.belief.intensity.shadowed import trust
from fieldkit.engine.belief.intensity.silence import note_heard
from fieldkit.engine.belief.intensity.watch import Watch, watch_receivers, without_insensitive
from fieldkit.engine.likelihood import levels_loops
from fieldkit.engine.likelihood.ears import Ears
from fieldkit.engine.likelihood.ears_loops import NORTH, UP
from fieldkit.engine.likelihood.levels import LevelsModel
from fieldkit.engine.likelihood.places import NOTHING_EARLIER, Earlier, PlaceNoise, levels_of
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Detection, FloatArray, Listening


@dataclass(frozen=True, slots=True, eq=False)
class OpenDetection:
    """A stored detection: its likelihood over the cells near it, scaled to a maximum of 1."""

    detection: Detection
    box: tuple[int, int, int, int]
    like: Row
    """(known levels, cells of the box, row by row); (known levels, 0) where it names its sender."""
    log_scale: float
    log_clutter: float
    """log intensity with which noise explains it: any strength within 80 dB."""
    near_m: FloatArray
    """(k, 2) where it was heard."""
    ears: FloatArray
    """(m, columns) of all who listened, as the likelihood sees them."""
    rss_dbm: FloatArray
    """(m,) how strongly they heard it; nan where at the receiver's ceiling, -inf where not at all."""
    sigma_m: float
    """Mean deviation of the positions of those who listened."""


class Mixture:
    """Candidates, open detections and exposure. Deterministic: same calls, same bits."""

    def __init__(self, settings: EngineSettings) -> None:
        self.settings, self.tuning = settings, settings.tuning.intensity
        self.field = settings.grid
        self.ground = ground_of(settings, self.tuning.ground_cells)
        self.grid = self.ground.grid
        self.ears = ears_of(settings)
        self.model = model_of(settings, self.ears)
        self.spread = settings.spread or assumed(settings.antenna)
        self.exposure_s = np.zeros((self.model.power_db.size, *self.grid.shape))
        """(h - 1, rows, columns of the ground): P(some robot hears) integrated over the time listened, by power."""
        self.cell_ears = replace(self.ears, point_sigma_m=_point_sigma_m(settings) * self.ground.factor)
        """As the ears, for likelihoods over the ground's cells."""
        self.places = (
            PlaceNoise(self.model, settings.spread, settings.reference_rate_hz)
            if settings.spread is not None and settings.place_noise
            else None
        )
        """What readings and silence of one place have in common; None where nothing."""
        self.rate_prior_s = self.tuning.rate_shape / settings.reference_rate_hz
        """b of the Gamma prior of a source's rate."""
        self._believe_nothing()

    def _believe_nothing(self) -> None:
        """Nothing was heard yet."""
        self.candidates: list[Candidate] = []
        self.open: dict[int, OpenDetection] = {}
        self.unclaimed: dict[int, float] = {}
        """Detection to the probability that a source not yet known sent it."""
        self.explained: dict[int, float] = {}
        """Detection to the log of the intensity with which clutter and the candidates explain it."""
        self.revise_at: dict[int, float] = {}
        """Candidate to the receptions at which its hypothesis is next re-estimated."""
        self.born: dict[int, births.Born] = {}
        """Candidates born at this detection."""
        self.stillborn: list[births.Born] = []
        """The same of those that did not last."""
        self.merge_at: dict[tuple[int, int, bool], float] = {}
        """Two candidates, close or not, to the receptions of both at which it is next asked whether they are one."""
        self.arena = Arena()
        """What candidates know of detections."""
        self.open_arena = Arena()
        """Likelihoods of the open detections over the grid."""
        self.log_unknown: dict[int, float] = {}
        """Open detection to the log of the intensity of sources not yet known, until the exposure changes."""
        self.watch = Watch()
        """Receivers against each other."""
        self.named: set[int] = set()
        """Open detections whose sender is known."""
        self._nameless = False
        self.said: list[str] = []
        """What there is to say of them, until somebody has read it."""
        self.now_ns = 0
        """Up to when something was heard, or listened to."""
        self.since_ns: int | None = None
        self.stay_s = self.tuning.change_s
        self.clutter_frozen = 0.0
        self.next_detection, self._next_ident = 0, 1
        self.unswept = False
        """Whether some open detections were left out of the passes since something was heard."""
        self._summaries: dict[int, Summary] = {}

    def listen(self, listening: Listening) -> None:
        """Add to the exposure of the ground where robots listened."""
        self.now_ns = max(self.now_ns, listening.t1_ns)
        self.log_unknown.clear()
        self.since_ns = listening.t0_ns if self.since_ns is None else min(self.since_ns, listening.t0_ns)
        hearing = [not self.is_insensitive(robot) for robot in listening.robots]
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
        new = [self._open(detection) for detection in detections]
        for candidate in self.candidates:
            trust(self, candidate, self.claimed_by(candidate))
            candidate.expose(self.exposure_at(candidate.points_m))
        sweep(self, 1, new)
        sweep_again(self, concerned(self, new))
        for _ in range(1 + len(detections)):
            born = births.birth(self)
            if born is None:
                break
            sweep_again(self, shares_of(born))
        self._settle()
        births.remember_births(self)
        watch_receivers(self, detections)
        for candidate in self.candidates:
            note_heard(self, candidate)
        freeze(self)

    def is_insensitive(self, robot: str) -> bool:
        return robot in self.watch.of and self.watch.of[robot].insensitive

    def reflect(self) -> bool | None:
        """Re-estimate one candidate's hypothesis; whether another was better, None where none was due.

        Where none is due, what the last passes left alone is looked at.
        """
        better = hypotheses.revise(self)
        if better:
            sweep(self, 1)
            sweep_again(self, self.open)
            self._settle()
        elif better is None and self.unswept:
            sweep(self, 1)
            return False
        return better

    def _open(self, detection: Detection) -> int:
        self.now_ns = max(self.now_ns, detection.t_ns)
        number = self.next_detection
        self.next_detection += 1
        named = self.settings.identity == "address" and detection.sender is not None
        if named:
            self.named.add(number)
        stored = self.store(number, without_insensitive(self, self.ears.corrected(detection)))
        self.open[number] = stored
        self.unclaimed[number], self.explained[number] = 1.0, stored.log_clutter
        if named and detection.sender is not None:
            births.claim_by_name(self, number, stored, detection.sender)
            return number
        if self.settings.identity == "address" and not self._nameless:
            self._nameless = True
            self.said.append(
                "sources.identity is 'address', and frames come in that name no sender: those are distinguished by "
                "where they are heard, as anonymous ones"
            )
        for candidate in self.candidates:
            if not candidate.name and self.in_reach(candidate, stored):
                candidate.know(number, self.log_likelihood(candidate, number))
        return number

    def claimed_by(self, candidate: Candidate) -> list[int]:
        """Open detections that are the candidate's own."""
        return [
            number
            for number, responsibility in candidate.responsibility.items()
            if responsibility >= self.tuning.claimed and number in self.open
        ]

    def log_likelihood(
        self, candidate: Candidate, number: int, claimed: list[int] | None = None
    ) -> FloatArray:
        """(h, n) of an open detection over the candidate's points, given what it claims to have sent before."""
        detection = self.open[number].detection
        if self.places is None:
            return self.model.log_likelihood(detection, candidate.points_m)
        if claimed is None:
            claimed = [other for other in self.claimed_by(candidate) if other < number]
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

    def _condition(self) -> None:
        """Compute anew what is conditioned on detections no longer claimed, or lacks one that is claimed now."""
        for candidate in self.candidates:
            if self.condition_on_each_other(candidate):
                self._summaries.pop(candidate.ident, None)

    def condition_on_each_other(self, candidate: Candidate) -> bool:
        """Condition each detection of a candidate on those it claims before it; whether any was conditioned anew."""
        anew = False
        own = self.claimed_by(candidate)
        in_order = own == sorted(own)
        for number, responsibility in candidate.responsibility.items():
            if responsibility < 0.05 or number not in self.open:
                continue
            claimed = own[: bisect_left(own, number)] if in_order else [o for o in own if o < number]
            if claimed == candidate.based_on.get(number):
                continue
            old = candidate.logs[number].array
            candidate.know(number, self.log_likelihood(candidate, number, claimed))
            candidate.evidence += responsibility * (candidate.logs[number].array - old)
            anew = True
        return anew

    def _settle(self) -> None:
        if self.places is not None:
            self._condition()
        if kept := merge(self):
            sweep_again(self, {number for candidate in kept for number in shares_of(candidate)})
        self._prune()

    def store(self, number: int, detection: Detection) -> OpenDetection:
        heard_at = detection.position_m[detection.heard]
        row0, row1, column0, column1 = self.grid.box_around(heard_at, self.model.reach_m)
        like, scale = np.empty((self.model.n_known, 0)), 0.0
        if number not in self.named:  # nobody else is asked for what names its sender
            east, north = self.grid.east_m[column0:column1], self.grid.north_m[row0:row1]
            points = np.column_stack([np.tile(east, north.size), np.repeat(north, east.size)])
            log = self.model.known_log_likelihood(detection, points, self.cell_ears)
            scale = float(log.max())
            like = np.exp(log - scale)
        clutter = float(np.log(self.tuning.clutter_hz) - len(heard_at) * np.log(80.0))
        return OpenDetection(
            detection,
            (row0, row1, column0, column1),
            self.open_arena.put(like),
            scale,
            clutter,
            heard_at,
            self.ears.of_detection(detection),
            np.where(detection.saturated, np.nan, np.where(detection.heard, detection.rss_dbm, -np.inf)),
            float(detection.sigma_m.mean()) if detection.sigma_m.size else 0.0,
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

    def summary(self, candidate: Candidate) -> Summary:
        """The candidate's posterior in a few numbers, kept until it changes."""
        if candidate.ident not in self._summaries:
            self._summaries[candidate.ident] = summarise(
                candidate,
                candidate.claimed_posterior(),
                self.model.power_db,
                self.model.outside,
                self.field.cell_m,
                self.settings.find_radius_m,
                self.ground.has_field(
                    candidate.points_m, max(self.settings.find_radius_m or 0.0, self.field.cell_m)
                ),
                shared_sigma_m(self, candidate),
            )
        return self._summaries[candidate.ident]

    def widen(self, wider: float) -> None:
        """Claim less of all candidates where squared residuals are `wider` than the antenna file says."""
        for candidate in self.candidates:
            if candidate.wider != wider:
                candidate.wider = wider
                self._summaries.pop(candidate.ident, None)

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

    def _prune(self) -> None:
        """Drop candidates that nothing supports any more; what they held is unclaimed again."""
        for candidate in [c for c in self.candidates if c.receptions < self.tuning.death_receptions]:
            for number, responsibility in candidate.responsibility.items():
                self.unclaimed[number] = min(1.0, self.unclaimed[number] + responsibility)
            self.remove(candidate)


def _point_sigma_m(settings: EngineSettings) -> float:
    """How far a source is from the point that stands for its place."""
    return float(settings.tuning.intensity.fine_cells * settings.grid.cell_m / np.sqrt(12.0))


def ears_of(settings: EngineSettings) -> Ears:
    """The receivers of a mission, as the likelihood sees them."""
    spread = settings.spread
    return Ears(
        settings.antenna,
        settings.source_up_m,
        spread.elevation if spread is not None else 0.0,
        settings.receivers,
        _point_sigma_m(settings),
        settings.pose_sigma_m,
        spread.receiver_db if spread is not None else 0.0,
        frozenset(robot for robot, radio in settings.receivers.items() if radio.offset_measured),
    )


def model_of(settings: EngineSettings, ears: Ears) -> LevelsModel:
    """What its receivers hear of a source of which power; its `reach_m` is the longest range of one that is known."""
    return LevelsModel(
        settings.antenna,
        levels_of(settings.power_levels_db, settings.spread),
        float(np.hypot(settings.pose_sigma_m, _point_sigma_m(settings))),
        settings.tuning.likelihood,
        ears,
    )
