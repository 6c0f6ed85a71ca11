"""Receivers watched against each other: one that reports more or less than the others, and one that is insensitive.

All receivers are measured by the same candidates. What one reports more than they predict, beyond what the others
report more, is its own offset; packets it should hear and does not make it insensitive. A receiver is named when
that can hardly be chance; from then on its readings are corrected, or its silence is left out. What all report more
than the power levels allow is the sources' or the antenna file's, and is said once.

A receiver that stands still measures the place and not itself: shadowing there, and an error of the candidate's
position, are in all its readings alike. What is off counts as often as it was met at another place, or of another
source.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import bdtr, ndtr

from fieldkit.channel.antenna_file import Receiver
from fieldkit.channel.spread import ChannelSpread
from fieldkit.engine.belief.intensity.candidate import Candidate
from fieldkit.engine.likelihood.ears_loops import THRESHOLD
from fieldkit.messages import Detection, part_of

if TYPE_CHECKING:
    from fieldkit.engine.belief.intensity.mixture import Mixture

LAST = 40
"""So many of a receiver's last packets are looked at."""
LEAST = 8
"""Fewer say nothing."""
LEAST_PLACES = 3.0
"""At fewer places, or of fewer sources, what is off is as likely the ground's: how rough that is, is but assumed."""
LEAST_OFFSET_DB, OFFSET_SIGMAS = 3.0, 3.5
REFINED_DB, REFINED_SIGMAS = 1.0, 2.0
"""What was learnt of a receiver once named is mended by no less than this."""
INSENSITIVE_BELOW = 1e-4
"""Probability of hearing so few by chance."""
SURE = 0.8
"""Only packets that were to be heard so probably are looked at: weak ones are heard when they read strong."""


WATCHED_FROM = 5.0
"""Receptions from which on a candidate is known well enough to measure receivers by."""


@dataclass(frozen=True, slots=True)
class Measured:
    """One packet that a receiver was to hear and heard."""

    residual_db: float
    """What it reported more than was to be expected."""
    expected_sd_db: float
    """How well that was known, with the source's position and power as uncertain as they are."""
    east_m: float
    north_m: float
    source: int
    """The candidate that sent it."""


@dataclass
class Heard:
    """Of one receiver."""

    measured: list[Measured] = field(default_factory=list)
    heard: list[bool] = field(default_factory=list)
    """Whether each of those was."""
    should: list[float] = field(default_factory=list)
    """P(heard) of each of those."""
    offset_db: float = 0.0
    """What is taken off its readings."""
    insensitive: bool = False


class Watch:
    """See the module. Deterministic."""

    def __init__(self) -> None:
        self.of: dict[str, Heard] = {}
        self._closed: dict[str, Mean] = {}
        """Receivers heard no more: what others are still compared with."""
        self._closed_offsets_db: dict[str, float] = {}
        self._common_said = False

    def take_in(self, mixture: "Mixture", detection: Detection, sender: Candidate) -> None:
        """A detection, as corrected so far, that a well known candidate sent beyond doubt."""
        fixed = sender.posterior()[: mixture.model.level_dbm.size]
        ears = mixture.ears.of_detection(detection)
        loss = mixture.ears.attenuation_db(sender.points_m, ears)
        power, place = fixed.sum(axis=1) / fixed.sum(), fixed.sum(axis=0) / fixed.sum()
        level = mixture.model.level_dbm @ power
        mean = level - place @ loss
        variance = power @ (mixture.model.level_dbm - level) ** 2 + place @ (loss - place @ loss) ** 2
        margin = (mean - ears[:, THRESHOLD] - 0.5) / mixture.settings.antenna.sigma_db
        should = (1.0 - mixture.model.tuning.packet_loss) * ndtr(margin)
        for robot, rss, expected, sd, p, at in zip(
            detection.robots,
            detection.rss_dbm,
            mean,
            np.sqrt(variance),
            should,
            detection.position_m,
            strict=True,
        ):
            if p < SURE:
                continue
            its = self.of.setdefault(robot, Heard())
            its.heard = [*its.heard, not np.isnan(rss)][-LAST:]
            its.should = [*its.should, float(p)][-LAST:]
            if not np.isnan(rss):
                new = Measured(float(rss - expected), float(sd), float(at[0]), float(at[1]), sender.ident)
                its.measured = [*its.measured, new][-LAST:]

    def close(self, spread: ChannelSpread) -> None:
        """Receivers so far are heard no more: each is judged no more, and others go on being compared with it."""
        self._closed_offsets_db = self.offsets_db()
        self._closed |= {robot: mean_of(its.measured, spread) for robot, its in self.of.items()}
        self.of = {}

    def offsets_db(self) -> dict[str, float]:
        """Robot to what is taken off its readings, where that is something."""
        now = {robot: its.offset_db for robot, its in self.of.items() if its.offset_db != 0.0}
        return self._closed_offsets_db | now

    def judge(self, spread: ChannelSpread, robots: int) -> list[str]:
        """What is new to say of this many receivers; offsets and insensitivity are brought up to date.

        Of three receivers one is compared with two: of two that differ nobody can say which is off.
        """
        said = []
        means = self._closed | {robot: mean_of(its.measured, spread) for robot, its in self.of.items()}
        for robot, its in self.of.items():
            said += self._judge_sensitivity(robot, its)
            said += self._judge_offset(robot, its, means, min(2, robots - 1))
        return said

    def _judge_sensitivity(self, robot: str, its: Heard) -> list[str]:
        count, heard = len(its.heard), sum(its.heard)
        if count < LEAST:
            return []
        chance = float(bdtr(heard, count, float(np.mean(its.should))))
        if not its.insensitive and chance < INSENSITIVE_BELOW:
            its.insensitive = True
            return [
                f"{robot}: heard {heard} of {count} packets that were to be heard where it was: is its antenna "
                "connected? Its silence is left out"
            ]
        if its.insensitive and chance > 0.01:
            its.insensitive = False
            return [f"{robot}: hears again ({heard} of {count} packets); its silence counts"]
        return []

    def _judge_offset(self, robot: str, its: Heard, means: "dict[str, Mean]", least: int) -> list[str]:
        others = [mean for name, mean in means.items() if name != robot and mean.is_enough]
        its_mean, count = means[robot], len(its.measured)
        if not its_mean.is_enough or not others or len(others) < least:
            return []
        more_db = its_mean.mean_db - float(np.median([each.mean_db for each in others]))
        error_db = np.sqrt(its_mean.variance_db2 + sum(o.variance_db2 for o in others) / len(others) ** 2)
        named = its.offset_db != 0.0
        least_db, sigmas = (REFINED_DB, REFINED_SIGMAS) if named else (LEAST_OFFSET_DB, OFFSET_SIGMAS)
        if abs(more_db) < max(least_db, sigmas * error_db):
            return []
        its.offset_db += more_db
        its.measured.clear()
        means[robot] = NOT_MEASURED
        if named and abs(more_db) < LEAST_OFFSET_DB:
            return []
        return [
            f"{robot}: reports {more_db:+.1f} dB against the other receivers ({count} readings); "
            f"{its.offset_db:+.1f} dB are taken off its readings. Calibrate it: fieldkit calibrate --receiver-offsets"
        ]

    def common(self, mixture: "Mixture") -> list[str]:
        """Said once: all sources read stronger, or weaker, than any power level that was given."""
        low, high = min(mixture.settings.power_levels_db), max(mixture.settings.power_levels_db)
        powers = [mixture.summary(each).power_db for each in mixture.candidates if each.receptions >= 4.0]
        beyond = np.array([power - np.clip(power, low, high) for power in powers])
        spread = mixture.settings.spread
        known = spread is None or spread.transmitter_db < LEAST_OFFSET_DB
        if (
            self._common_said
            or beyond.size < 2
            or not known
            or abs(float(np.median(beyond))) < LEAST_OFFSET_DB
        ):
            return []
        self._common_said = True
        return [
            f"the sources read {float(np.median(beyond)):+.0f} dB beyond the power levels in the mission file: the "
            "antenna file may be of other radios; the power is taken for unknown as far as that"
        ]


@dataclass(frozen=True, slots=True)
class Mean:
    """Of what one receiver reported more than was to be expected."""

    mean_db: float
    variance_db2: float
    places: float
    """At so many places, or of so many sources, as if these had nothing in common."""
    count: int

    @property
    def is_enough(self) -> bool:
        """Whether it says anything about the receiver."""
        return self.count >= LEAST and self.places >= LEAST_PLACES


NOT_MEASURED = Mean(0.0, np.inf, 0.0, 0)


def mean_of(measured: Sequence[Measured], spread: ChannelSpread) -> Mean:
    """The mean of what was measured at these places, of these sources.

    Of the same source, what the place and its lobe add is alike with correlation exp(-distance / correlation_m), and an
    error of its position or power likewise; noise in time is of each alone.
    """
    if not measured:
        return NOT_MEASURED
    residual_db, sd, east, north, source = np.array(
        [(m.residual_db, m.expected_sd_db, m.east_m, m.north_m, m.source) for m in measured]
    ).T
    apart_m = np.hypot(east[:, None] - east, north[:, None] - north)
    alike = np.exp(-apart_m / max(spread.correlation_m, 1e-6)) * (source[:, None] == source)
    place_db2 = spread.sigma_place_db**2 + spread.lobe_db**2
    shared = (alike * (place_db2 + np.outer(sd, sd))).mean()
    variance = float(shared + spread.sigma_time_db**2 / len(measured))
    return Mean(float(residual_db.mean()), variance, float(1.0 / alike.mean()), len(measured))


def without_insensitive(mixture: "Mixture", detection: Detection) -> Detection:
    """The detection without robots whose silence says nothing."""
    keep = ~np.isnan(detection.rss_dbm) | np.array([not mixture.is_insensitive(r) for r in detection.robots])
    return detection if keep.all() else part_of(detection, keep)


def watch_receivers(mixture: "Mixture", detections: Sequence[Detection]) -> None:
    """Measure receivers by what has just been heard of sources that are well known."""
    for number, detection in zip(list(mixture.open)[-len(detections) :], detections, strict=False):
        for candidate in mixture.candidates:
            known = candidate.receptions >= WATCHED_FROM and mixture.summary(candidate).p_here >= 0.5
            if known and candidate.responsibility.get(number, 0.0) >= 0.9:
                mixture.watch.take_in(mixture, mixture.ears.corrected(detection), candidate)
    before = mixture.watch.offsets_db()
    mixture.said += [
        *mixture.watch.judge(mixture.spread, len(mixture.settings.robots)),
        *mixture.watch.common(mixture),
    ]
    learnt = mixture.watch.offsets_db()
    if learnt and learnt != before:
        _correct(mixture, learnt)


def _correct(mixture: "Mixture", learnt: dict[str, float]) -> None:
    """Take what was learnt off further readings, and off those that are in and not frozen yet."""
    before = mixture.ears
    receivers = dict(mixture.settings.receivers)
    for robot, offset_db in learnt.items():
        own = receivers.get(robot, Receiver())
        receivers[robot] = replace(own, offset_db=own.offset_db + offset_db)
    mixture.ears = replace(mixture.ears, receivers=receivers)
    mixture.cell_ears = replace(mixture.cell_ears, receivers=receivers)
    mixture.model.ears = mixture.ears
    for number, stored in mixture.open.items():
        raw = before.uncorrected(stored.detection)
        mixture.open[number] = mixture.store(number, mixture.ears.corrected(raw))
    mixture.log_unknown.clear()
    for candidate in mixture.candidates:
        for number in candidate.logs:
            responsibility, old = candidate.responsibility[number], candidate.logs[number].array
            candidate.know(number, mixture.log_likelihood(candidate, number))
            candidate.evidence += responsibility * (candidate.logs[number].array - old)
        mixture.forget_summary(candidate)
        mixture.revise_at[candidate.ident] = 0.0  # ground that wrong readings ruled out is to be had back
