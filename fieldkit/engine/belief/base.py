"""What every belief offers to the kernel, the planners and the viewers."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Detection, FloatArray, Listening, SourceEstimate


@dataclass(frozen=True, slots=True)
class Unresolved:
    """What a planner needs to know of a candidate: k samples of where and how strong it may be."""

    ident: int
    """As in `SourceEstimate.ident`."""
    points_m: FloatArray
    """(k, 2) equally likely places, east and north."""
    level: FloatArray
    """(k,) the power hypothesis at each: a row of the belief's `model.hear`."""
    cov_m2: FloatArray
    """(2, 2) covariance of the place."""
    rate_hz: float
    """Expected rate of transmissions."""
    receptions: float
    """Expected number of transmissions heard from it."""
    p_here: float
    """Probability that it lies as near to its estimate as a find has to."""
    state: str
    """As in `SourceEstimate.state`."""
    may_be_two: bool
    """Whether two sources explain what was heard about as well."""
    p_gone: float = 0.0
    """Of a find: the probability that it has ended or was moved since it was last heard."""


@runtime_checkable
class SayingBelief(Protocol):
    """A belief that has something to say: of the receivers, and for which sources `probability_left` holds."""

    def said(self) -> list[str]:
        """What is new to say of the receivers since this was last asked: which hears too little or reports too much."""
        ...

    def left_words(self) -> str:
        """For which senders `probability_left` holds."""
        ...


@runtime_checkable
class PartingBelief(Protocol):
    """A belief that watches receivers, and can be told which it need watch no more."""

    def part_with_robots(self) -> None:
        """All robots so far are heard no more: others come. What was learnt of their receivers stays."""
        ...


class RidgedBelief(Protocol):
    """What planners that look for ridges need of a belief."""

    def presence(self) -> FloatArray:
        """As a belief's."""
        ...

    def activity(self) -> FloatArray:
        """As a belief's."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """A belief as it was at a moment: as much of it as planners look at that look for ridges."""

    _presence: FloatArray
    _activity: FloatArray

    @classmethod
    def of(cls, belief: RidgedBelief) -> "Snapshot":
        """`belief` as it is now."""
        return cls(np.array(belief.presence()), np.array(belief.activity()))

    def presence(self) -> FloatArray:
        """(n_north, n_east) as it was."""
        return self._presence

    def activity(self) -> FloatArray:
        """(n_north, n_east) as it was."""
        return self._activity


class Belief(Protocol):
    """A belief over the field. Deterministic: the same calls in the same order give the same bits."""

    def __init__(self, settings: EngineSettings) -> None: ...

    def detect(self, detection: Detection) -> None:
        """Take in one transmission heard by at least one robot."""
        ...

    def detect_all(self, detections: Sequence[Detection]) -> None:
        """Take in several, which a belief may do with one look at them all; what takes long is left to `reflect`."""
        ...

    def reflect(self) -> bool:
        """Think over what has been taken in, now that nothing is heard; whether anything has changed."""
        ...

    def listen(self, listening: Listening) -> None:
        """Take in a stretch of time in which robots listened; what they heard comes as detections."""
        ...

    def presence(self) -> FloatArray:
        """(n_north, n_east) probability that the cell holds a source: SPOG's P(C_i), or its like."""
        ...

    def activity(self) -> FloatArray:
        """(n_north, n_east), sums to 1: where the next transmission is likely to come from, P(C_i^1)."""
        ...

    def sources(self) -> list[SourceEstimate]:
        """Candidates and found sources, by identity."""
        ...

    def probability_left(self) -> float:
        """Probability that at least one source of the reference rate is still not found."""
        ...

    def digest(self) -> bytes:
        """32 bytes that differ when the belief differs in any bit."""
        ...
