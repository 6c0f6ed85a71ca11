"""Messages to record: one of every kind, and hypothesis strategies for any of them."""

import math

import numpy as np
from hypothesis import strategies as st

from fieldkit.messages import (
    Detection,
    EndMission,
    GoTo,
    Hold,
    Operator,
    Plan,
    Pose,
    ReceiverState,
    Return,
    RssReading,
    SourceEstimate,
    Tick,
    VehicleState,
    Waypoint,
)
from fieldkit.recording.schema import BeliefDigest, Note

numbers = st.floats(allow_nan=True, allow_infinity=True)
instants = st.integers(0, 2**63)
texts = st.text(max_size=12)
rows = st.integers(0, 5)
waypoints = st.builds(Waypoint, numbers, numbers, numbers, numbers)


def arrays(*shape: int) -> st.SearchStrategy:
    size = math.prod(shape)
    return st.lists(numbers, min_size=size, max_size=size).map(lambda xs: np.array(xs, float).reshape(shape))


@st.composite
def detections(draw) -> Detection:
    m = draw(rows)
    robots = tuple(draw(st.lists(texts, min_size=m, max_size=m)))
    saturated = np.array(draw(st.lists(st.booleans(), min_size=m, max_size=m)), dtype=bool)
    return Detection(draw(instants), robots, draw(arrays(m, 2)), draw(arrays(m)), draw(arrays(m)), saturated)


events = st.one_of(
    st.builds(
        RssReading,
        instants,
        texts,
        numbers,
        st.sampled_from(["rx64", "db", "sim"]),
        st.none() | st.integers(11, 26),
        st.none() | texts,
        st.none() | st.integers(0, 255),
        st.booleans(),
    ),
    st.builds(ReceiverState, instants, texts, st.booleans(), texts),
    st.builds(Pose, instants, texts, numbers, numbers, numbers, numbers, numbers, texts),
    st.builds(
        VehicleState,
        instants,
        texts,
        st.sampled_from(["guided", "hold", "unknown"]),
        st.booleans(),
        st.booleans(),
        st.none() | numbers,
        texts,
    ),
    st.builds(Tick, instants),
    st.builds(Operator, instants, st.sampled_from(["hold", "end"]), st.none() | texts, texts),
)
commands = st.one_of(
    st.builds(GoTo, instants, texts, waypoints),
    st.builds(Hold, instants, texts, texts),
    st.builds(Return, instants, texts, texts),
    st.builds(EndMission, instants, texts),
)
others = st.one_of(
    detections(),
    st.builds(
        Plan,
        instants,
        st.dictionaries(texts, st.lists(waypoints, max_size=3).map(tuple), max_size=3),
        st.dictionaries(texts, texts, max_size=3),
    ),
    st.builds(
        SourceEstimate,
        st.integers(0, 99),
        numbers,
        numbers,
        arrays(2, 2),
        st.integers(0, 2500),
        numbers,
        numbers,
        numbers,
        numbers,
        st.sampled_from(["candidate", "found", "inconsistent"]),
        texts,
        numbers,
    ),
    st.builds(Note, st.sampled_from(["info", "error"]), texts),
    st.builds(BeliefDigest, texts, texts, st.dictionaries(texts, numbers, max_size=3)),
)


def same(a, b) -> bool:
    """Equal in every field, type included; nan equals nan and -0.0 differs from 0.0."""
    if type(a) is not type(b):
        return False
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and a.shape == b.shape and same(a.tolist(), b.tolist())
    if hasattr(a, "__dataclass_fields__"):
        return all(same(getattr(a, f), getattr(b, f)) for f in a.__dataclass_fields__)
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[k], b[k]) for k in a)
    if isinstance(a, tuple | list):
        return len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, float):
        return (math.isnan(a) and math.isnan(b)) or (a == b and math.copysign(1, a) == math.copysign(1, b))
    return a == b


def mission(seconds: int = 3) -> list:
    """Events of a small mission at 10 Hz: ticks, poses and readings of two robots."""
    events: list = []
    for i in range(10 * seconds):
        t_ns = 1_700_000_000_000_000_000 + i * 100_000_000
        events += [Pose(t_ns, robot, 0.1 * i, i / 3, sigma_m=0.02) for robot in ("r1", "r2")]
        if i % 3 == 0:
            events.append(RssReading(t_ns + 5, "r1", -60.0 - i % 7, via="rx64", channel=15, frame_id="00:1"))
        events.append(Tick(t_ns + 9))
    return events


def detection() -> Detection:
    places, heard = np.array([[0.1, 0.2], [1, 2]]), np.array([-61.0, np.nan])
    return Detection(5, ("r1", "r2"), places, np.zeros(2), heard, np.zeros(2, bool))


def estimate() -> SourceEstimate:
    return SourceEstimate(1, 2.0, 3.0, np.diag([0.1, 0.2]), 4, 3.5, 0.1, 0.99, 0.95, "found")
