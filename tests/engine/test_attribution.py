"""The compiled passes of the default belief against plain numpy, written from what they are to compute."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as budget
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.special import logsumexp

from fieldkit.engine.belief.intensity import loops
from fieldkit.engine.belief.intensity.arena import Arena, starts
from fieldkit.engine.belief.intensity.candidate import Candidate
from fieldkit.engine.belief.intensity.responsibilities import Attribution, attribute
from fieldkit.engine.planning import path_loops
from fieldkit.tuning import IntensityTuning

PRIOR_S = 20.0
TUNING = IntensityTuning()


def some_candidates(rng: np.random.Generator, count: int, detections: int) -> list[Candidate]:
    """Candidates of unlike sizes that know most of the detections and claim some of each."""
    result, arena = [], Arena()
    for ident in range(count):
        points, levels = int(rng.integers(3, 40)), 3
        candidate = Candidate(
            ident,
            rng.uniform(0, 9, (points, 2)),
            rng.normal(-5, 1, (levels, points)),
            PRIOR_S,
            rng.uniform(0, 300, (levels, points)),
            0.5,
            arena,
            TUNING,
        )
        for number in range(detections):
            if rng.random() < 0.8:
                candidate.know(number, rng.normal(-12, 4, (levels, points)))
                candidate.set_responsibility(number, float(rng.uniform(0, 1 / count)))
        result.append(candidate)
    return result


def plain_pass(
    candidates: list[Candidate],
    numbers: list[int],
    log_unknown: NDArray[np.float64],
    log_clutter: NDArray[np.float64],
    mean_exposure_s: NDArray[np.float64],
) -> tuple[list[float], list[float]]:
    """The same pass on the candidates themselves: (unclaimed, explained)."""
    unclaimed, explained = [], []
    for k, number in enumerate(numbers):
        near = [(c, seen) for c, seen in zip(candidates, mean_exposure_s, strict=True) if number in c.logs]
        terms = [log_unknown[k], log_clutter[k]]
        for candidate, seen in near:
            others = candidate.receptions - candidate.responsibility[number]
            without = (
                candidate.log_posterior() - candidate.responsibility[number] * candidate.logs[number].array
            )
            predicted = logsumexp(without + candidate.logs[number].array) - logsumexp(without)
            terms.append(np.log((TUNING.rate_shape + others) / (PRIOR_S + seen)) + predicted)
        shares = np.exp(terms - logsumexp(terms))
        unclaimed.append(float(shares[0]) if near else 1.0)
        explained.append(float(logsumexp(terms[1:])))
        for (candidate, _), share in zip(near, shares[2:], strict=True):
            candidate.set_responsibility(number, float(share))
    return unclaimed, explained


@budget(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000), count=st.integers(0, 4), detections=st.integers(1, 12))
def test_a_pass_shares_detections_out_as_plain_numpy_does(seed: int, count: int, detections: int) -> None:
    rng = np.random.default_rng(seed)
    ours = some_candidates(np.random.default_rng(seed), count, detections)
    twins = some_candidates(np.random.default_rng(seed), count, detections)
    numbers = list(range(detections))
    unknown, clutter = rng.normal(-14, 3, detections), rng.normal(-18, 1, detections)
    seen = rng.uniform(0, 200, count)
    left = Attribution(np.ones(detections), clutter.copy())
    attribute(
        ours[0].arena if ours else Arena(),
        ours,
        numbers,
        unknown,
        clutter,
        lambda: seen,
        TUNING.rate_shape,
        PRIOR_S,
        left,
        passes=1,
    )
    # Entries 25 nats down are left out: likelihoods as unlike as these make some 1e-5 of that.
    unclaimed, explained = plain_pass(twins, numbers, unknown, clutter, seen)
    assert left.unclaimed == pytest.approx(unclaimed, abs=1e-4)
    assert left.explained == pytest.approx(explained, abs=1e-4)
    for one, other in zip(ours, twins, strict=True):
        assert one.responsibility == pytest.approx(other.responsibility, abs=1e-4)
        assert one.evidence == pytest.approx(other.evidence, abs=3e-3)


def in_single(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """As an arena keeps them."""
    return values.astype(np.float32).astype(np.float64)


def test_what_the_unknown_explains_is_its_rate_times_the_likelihood() -> None:
    rng = np.random.default_rng(5)
    rate = rng.uniform(0, 1e-5, (7, 9))
    boxes = np.array([[0, 4, 2, 8], [3, 7, 0, 9], [2, 3, 2, 3], [1, 1, 2, 2]])
    likes = [in_single(rng.uniform(0, 1, (3, (b[1] - b[0]) * (b[3] - b[2])))) for b in boxes]
    arena = Arena()
    rows = [arena.put(like) for like in likes]
    out = np.empty(4)
    loops.log_expected(arena.values, starts(rows), boxes, 3, rate, out)
    for log, like, (row0, row1, column0, column1) in zip(out, likes, boxes, strict=True):
        mean = like.mean(axis=0).reshape(row1 - row0, column1 - column0)
        expected = float((rate[row0:row1, column0:column1] * mean).sum())
        assert log == pytest.approx(np.log(expected + 1e-300), abs=1e-12)


def test_one_more_source_is_weighed_as_the_poisson_process_says() -> None:
    rng = np.random.default_rng(3)
    exposure = rng.uniform(0, 50, (2, 7, 9))
    boxes = np.array([[0, 4, 2, 8], [3, 7, 0, 9], [2, 3, 2, 3]])
    likes = [in_single(rng.uniform(0, 1, (2, (b[1] - b[0]) * (b[3] - b[2])))) for b in boxes]
    factor = np.array([0.7, 30.0, 1e-4])
    expected = -0.05 * exposure
    for like, (row0, row1, column0, column1), f in zip(likes, boxes, factor, strict=True):
        part = like.reshape(2, row1 - row0, column1 - column0)
        expected[:, row0:row1, column0:column1] += np.log1p(f * part)
    out = np.empty_like(exposure)
    arena = Arena()
    rows = [arena.put(like) for like in likes]
    loops.another_source_llr(arena.values, starts(rows), boxes, factor, exposure, 0.05, out)
    assert out == pytest.approx(expected, abs=1e-11)


def plain_ground_gain(
    track: NDArray[np.float64],
    worth: NDArray[np.float64],
    cell: float,
    hear: NDArray[np.float64],
    step2: float,
    ears: NDArray[np.float64],
) -> tuple[float, NDArray[np.float64]]:
    north, east = np.meshgrid(*((np.arange(n) + 0.5) * cell for n in worth.shape), indexing="ij")
    exposure = np.zeros(worth.shape)
    for robots in track:
        silent = np.ones(worth.shape)
        for (e, n), (up, factor, _) in zip(robots, ears, strict=True):
            k = (((east - e) ** 2 + (north - n) ** 2 + up**2) * factor / step2).astype(int)
            silent *= 1.0 - np.where(k < hear.size - 1, hear[np.minimum(k, hear.size - 1)], 0.0)
        exposure += 1.5 * (1.0 - silent)
    return float((worth * (1.0 - np.exp(-0.1 * exposure))).sum()), exposure


@budget(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000), robots=st.integers(1, 3), raised=st.booleans())
def test_ground_is_gained_as_plain_numpy_says(seed: int, robots: int, raised: bool) -> None:
    rng = np.random.default_rng(seed)
    track, worth = rng.uniform(-2, 12, (5, robots, 2)), rng.uniform(0, 1, (12, 9))
    hear, reach = np.sort(rng.uniform(0, 0.9, 65))[::-1].copy(), 3.3
    step2 = reach**2 / 64.0
    ears = np.array([[0.8 if raised else 0.0, 1.2 if raised else 1.0, 0.0]] * robots)
    scratch = np.zeros(worth.shape)
    gain = path_loops.path_ground_gain(track, 1.5, worth, 1.1, hear, step2, reach, 0.1, ears, scratch)
    expected, exposure = plain_ground_gain(track, worth, 1.1, hear, step2, ears)
    assert gain == pytest.approx(expected, rel=1e-9, abs=1e-12)
    assert scratch == pytest.approx(exposure, abs=1e-9)


def plain_abreast(
    path: NDArray[np.float64], start: NDArray[np.float64], spacing: float, low: float, high: float
) -> NDArray[np.float64]:
    before, centre, side, places = start, start.mean(axis=0), np.array([0.0, 1.0]), []
    for target in path:
        step = target - centre
        if np.hypot(*step) > 1e-6:
            side = np.array([-step[1], step[0]]) / np.hypot(*step)
        offsets = (np.arange(len(start)) - (len(start) - 1) / 2) * spacing
        slots = target + offsets[:, None] * side
        slots = slots + np.maximum(low - slots.min(axis=0), 0.0) + np.minimum(high - slots.max(axis=0), 0.0)
        slots = np.clip(slots, low, high)
        turned = slots[::-1]
        if len(start) == 2 and np.hypot(*(turned - before).T).sum() < np.hypot(*(slots - before).T).sum():
            slots = turned
        places.append(slots)
        before, centre = slots, slots.mean(axis=0)
    return np.array(places)


@budget(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10_000), robots=st.integers(1, 4), legs=st.integers(1, 6))
def test_a_team_moves_abreast_as_plain_numpy_says(seed: int, robots: int, legs: int) -> None:
    rng = np.random.default_rng(seed)
    path, start = rng.uniform(-1, 11, (legs, 2)), rng.uniform(0, 10, (robots, 2))
    places = np.empty((legs, robots, 2))
    path_loops.abreast(path, start, 1.3, np.full(2, 0.2), np.full(2, 9.8), places)
    assert places == pytest.approx(plain_abreast(path, start, 1.3, 0.2, 9.8), abs=1e-9)


def plain_track(
    places: NDArray[np.float64],
    start: NDArray[np.float64],
    speed: float,
    step: float,
    steps: int,
    turn: float,
) -> NDArray[np.float64]:
    corners = np.concatenate([start[None], places])
    legs = np.diff(corners, axis=0)
    lengths = np.hypot(legs[..., 0], legs[..., 1])
    heading = np.arctan2(legs[..., 0], legs[..., 1])
    turned = np.abs((np.diff(heading, axis=0) + np.pi) % (2 * np.pi) - np.pi)
    turned[(lengths[1:] < 1e-6) | (lengths[:-1] < 1e-6)] = 0.0
    turn_s = np.concatenate([[0.0], turned.max(axis=1) / turn])
    drive_s = lengths.max(axis=1) / speed + 1e-12
    at_s = np.concatenate([[0.0], np.cumsum(turn_s + drive_s)])
    t = (np.arange(steps) + 0.5) * step
    leg = np.clip(np.searchsorted(at_s, t, side="right") - 1, 0, len(drive_s) - 1)
    share = np.clip((t - at_s[leg] - turn_s[leg]) / drive_s[leg], 0.0, 1.0)
    return np.asarray(corners[leg] + share[:, None, None] * (corners[leg + 1] - corners[leg]))


@budget(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10_000), robots=st.integers(1, 3), legs=st.integers(1, 6))
def test_a_team_is_on_its_way_where_plain_numpy_says(seed: int, robots: int, legs: int) -> None:
    rng = np.random.default_rng(seed)
    places, start = rng.uniform(0, 10, (legs, robots, 2)), rng.uniform(0, 10, (robots, 2))
    out = np.empty((30, robots, 2))
    path_loops.track(places, start, 0.4, 1.5, 1.5, out)
    assert out == pytest.approx(plain_track(places, start, 0.4, 1.5, 30, 1.5), abs=1e-9)


@budget(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10_000), robots=st.integers(1, 3), others=st.integers(1, 4))
def test_tracks_meet_where_plain_numpy_says(seed: int, robots: int, others: int) -> None:
    rng = np.random.default_rng(seed)
    one, other = rng.uniform(0, 4, (5, robots, 2)), rng.uniform(0, 4, (5, others, 2))
    gaps = np.hypot(*np.moveaxis(one[:, :, None] - other[:, None, :], -1, 0))
    separation = float(rng.uniform(0.05, 1.5))
    expected = bool((gaps[1:] < np.minimum(separation, gaps[0] - 1e-6)).any())
    assert path_loops.meets(one, other, separation) == expected
