"""Readings and silence of one place: against plain numpy, and what becomes of them where places make no noise."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm
from sizes import size

from fieldkit.channel.model import MIN_RANGE_M, Antenna
from fieldkit.channel.spread import ChannelSpread
from fieldkit.engine.belief.intensity.belief import IntensityBelief
from fieldkit.engine.grid import Grid
from fieldkit.engine.likelihood import levels_loops
from fieldkit.engine.likelihood.ears import Ears
from fieldkit.engine.likelihood.ears_loops import OFFSET, ROBOT
from fieldkit.engine.likelihood.levels import LevelsModel
from fieldkit.engine.likelihood.places import (
    DEEPEST,
    NEIGHBOURS,
    NOTHING_EARLIER,
    REACH,
    Earlier,
    PlaceNoise,
    levels_of,
    redundancy,
)
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Detection, Listening
from fieldkit.tuning import LikelihoodTuning, Tuning
from fieldkit.world.shadowing import ShadowField

RADIO = LikelihoodTuning()

LEVELS = (-8.0, -4.0, 0.0)
SPREAD = ChannelSpread(2.0, 4.0, 3.0, transmitter_db=0.1, lobe_db=0.0)
ANTENNA = Antenna(2.53, -62.0, float(np.hypot(2.0, 4.0)), -80.0)
NONE = NOTHING_EARLIER


def earlier_at(model, position, rss, robots=("r0",)):
    """Readings of robots on the ground, who take turns."""
    place, none = np.array(position, dtype=float).reshape(-1, 2), np.empty(0)
    turns = [robots[k % len(robots)] for k in range(len(place))]
    return Earlier(model.ears.of(turns, place, none, none, none), np.array(rss, dtype=float))


def detection(rss, position, t_ns=0):
    m = len(rss)
    return Detection(
        t_ns,
        tuple(f"r{i}" for i in range(m)),
        np.array(position, dtype=float).reshape(m, 2),
        np.zeros(m),
        np.array(rss, dtype=float),
        np.zeros(m, dtype=bool),
    )


def noise(spread=SPREAD, antenna=ANTENNA, levels=LEVELS, receiver_db=0.0, measured=()):
    ears = Ears(antenna, point_sigma_m=0.1, receiver_db=receiver_db, measured=frozenset(measured))
    model = LevelsModel(antenna, levels, 0.1, ears=ears)
    return model, PlaceNoise(model, spread, 0.05)


def test_one_robot_and_nothing_earlier_is_the_reading_alone():
    model, places = noise()
    d = detection([-70.0], [(1.0, 2.0)])
    points = np.random.default_rng(0).uniform(0.0, 6.0, (50, 2))
    assert places.log_likelihood(d, points, NONE) == pytest.approx(model.log_likelihood(d, points), abs=1e-9)


@pytest.mark.parametrize(
    "still",
    [ChannelSpread(ANTENNA.sigma_db, 0.0, 3.0, lobe_db=0.0), ChannelSpread(2.0, 4.0, 0.0, lobe_db=0.0)],
)
def test_without_place_noise_it_equals_independent_readings(still):
    """Two robots and a reading before: with nothing that belongs to places, or no correlation, all stand alone."""
    model, places = noise(still)
    d = detection([-70.0, np.nan, -66.0], [(1.0, 2.0), (4.0, 4.0), (1.5, 2.0)])
    points = np.random.default_rng(1).uniform(0.0, 6.0, (50, 2))
    earlier = earlier_at(model, [[1.1, 2.0], [1.0, 2.0]], [-60.0, -61.0])
    assert places.log_likelihood(d, points, earlier) == pytest.approx(
        model.log_likelihood(d, points), abs=1e-9
    )


def residuals(rss, mean):
    """What readings are off the mean; where nothing was heard, what silence is mostly off, and never more than it."""
    silent = np.isinf(rss)
    off = np.where(silent, -79.5 - 0.8 * np.sqrt(20.0), rss) - mean
    return np.where(silent, np.minimum(off, 0.0), off)


def log_read(z, mean, sigma):
    """log p of a reading, or of silence (-inf)."""
    if np.isinf(z):
        return np.log(RADIO.packet_loss + (1 - RADIO.packet_loss) * norm.cdf(-79.5, mean, sigma))
    wide = np.sqrt(sigma**2 + 1.0 / 12.0)
    core, tail = norm.pdf(z, mean, wide), norm.pdf(z, mean, RADIO.outlier_width * wide)
    return np.log((1 - RADIO.packet_loss) * ((1 - RADIO.outliers) * core + RADIO.outliers * tail))


def twin(model, d, point, level_dbm, earlier, lobe_db=0.0):
    """log p robot by robot, those who heard first, from the docstrings of `levels` and `places`."""
    smear = 25.3 / np.log(10.0) * model.place_sigma_m
    place, rss, now = list(earlier.ears[:, :2]), list(earlier.rss_dbm), [False] * len(earlier.ears)
    whose, own_ears = list(earlier.ears[:, ROBOT]), model.ears.of_detection(d)
    off2 = np.pi / 2.0 * 2.0 * model.place_sigma_m**2
    total = 0.0

    def direction(a):
        range2 = max(float(((a - point) ** 2).sum()), MIN_RANGE_M**2)
        return (a - point) / np.sqrt(range2 + model.place_sigma_m**2)

    def shadow(a, b, same_time, offset):
        alike = 16.0 * np.exp(-np.sqrt(((a - b) ** 2).sum() + (0.0 if same_time else off2)) / 3.0)
        return alike + offset + lobe_db**2 * float(direction(a) @ direction(b))

    for q in np.argsort(~d.heard, kind="stable"):
        at = d.position_m[q]
        u = direction(at)
        offset2 = 0.0 if d.robots[q] in model.ears.measured else model.ears.receiver_db**2
        of_robot = {own_ears[k, ROBOT]: own_ears[k, OFFSET] for k in range(len(own_ears))}
        shift, left = 0.0, 4.0 + 16.0 + offset2 + lobe_db**2 * float(u @ u)
        if place:
            range2 = np.array([max(float(((p - point) ** 2).sum()), MIN_RANGE_M**2) for p in place])
            both = list(zip(place, now, whose, strict=True))
            cov = np.array(
                [
                    [shadow(a, b, x and y, of_robot[u] if u == v else 0.0) for a, x, u in both]
                    for b, y, v in both
                ]
            )
            cov += np.diag(4.0 + 1.0 / 12.0 + smear**2 / (range2 + model.place_sigma_m**2))
            for k in range(len(place)):
                cov[k, k] += 16.0 - 16.0 * np.exp(-(0.0 if now[k] else np.sqrt(off2)) / 3.0)
            mine = own_ears[q, ROBOT]
            cross = np.array([shadow(p, at, x, offset2 if u == mine else 0.0) for p, x, u in both])
            weights = np.linalg.solve(cov, cross)
            shift = float(weights @ residuals(np.array(rss), level_dbm - 12.65 * np.log10(range2)))
            left -= float(weights @ cross)
        furthest = DEEPEST * np.sqrt(16.0 + offset2 + lobe_db**2 * float(u @ u))
        shift = float(np.clip(shift, -furthest, furthest))
        range2 = max(float(((at - point) ** 2).sum()), MIN_RANGE_M**2)
        sigma = np.sqrt(left + smear**2 / (range2 + model.place_sigma_m**2))
        mean = level_dbm - 12.65 * np.log10(range2) + shift
        z = -np.inf if np.isnan(d.rss_dbm[q]) else d.rss_dbm[q]
        total += log_read(z, mean, sigma)
        place, rss, now, whose = [*place, at], [*rss, z], [*now, True], [*whose, own_ears[q, ROBOT]]
    return total


@pytest.mark.parametrize(("receiver_db", "lobe_db"), [(0.0, 0.0), (3.0, 0.0), (0.0, 3.0), (2.0, 2.0)])
def test_the_compiled_loop_agrees_with_a_plain_twin(receiver_db, lobe_db):
    model, places = noise(replace(SPREAD, lobe_db=lobe_db), receiver_db=receiver_db, measured=["r2"])
    d = detection([-70.0, np.nan, -66.0, np.nan], [(1.0, 2.0), (4.0, 4.0), (1.5, 2.0), (4.5, 3.5)])
    earlier = earlier_at(
        model, [[1.1, 2.0], [3.0, 3.0], [2.0, 2.0]], [-60.0, -np.inf, -65.0], ("r0", "r2", "r1")
    )
    points = np.random.default_rng(2).uniform(0.0, 6.0, (30, 2))
    log = places.log_likelihood(d, points, earlier)
    for h, level in enumerate(model.level_dbm):
        assert log[h] == pytest.approx([twin(model, d, p, level, earlier, lobe_db) for p in points], abs=2e-4)


def test_who_missed_packets_at_a_place_is_expected_to_miss_more_there():
    """What was heard there alone is what was strong: conditioned on that only, silence would always be a surprise."""
    model, places = noise()
    here, point = [(9.0, 0.0)], np.zeros((1, 2))
    heard = earlier_at(model, here * 2, [-76.0, -75.0])
    both = earlier_at(model, here * 6, [-76.0, -np.inf, -np.inf, -75.0, -np.inf, -np.inf])
    missed, again = detection([np.nan], here), detection([-75.0], here)

    def of(d, earlier):
        return places.log_likelihood(d, point, earlier)[LEVELS.index(0.0), 0]

    assert of(missed, both) > of(missed, heard) + 0.1 and of(again, both) < of(again, heard) - 0.1
    # Where nothing is expected anyway, silence says nothing: no shadow is learnt from it.
    far = np.array([[-60.0, 0.0]])
    alone = places.log_likelihood(missed, far, NONE)
    assert places.log_likelihood(missed, far, earlier_at(model, here, [-np.inf])) == pytest.approx(
        alone, abs=0.02
    )


def test_the_choice_of_neighbours_agrees_with_a_plain_twin():
    rng = np.random.default_rng(5)
    model, places = noise()
    d = detection([-70.0, np.nan, -66.0, -60.0], rng.uniform(0.0, 8.0, (4, 2)))
    earlier = earlier_at(model, rng.uniform(0.0, 8.0, (40, 2)), rng.uniform(-80.0, -50.0, 40))
    ears = model.ears.of_detection(d)
    near = places._neighbours(d, ears, earlier)
    own = rng.uniform(4.0, 8.0, near.rss_dbm.shape)
    weights, explained = near.weighed(own)
    before, rss, now = earlier.ears, earlier.rss_dbm, np.zeros(40, dtype=bool)
    off2 = np.pi * model.place_sigma_m**2

    def shadow(a, b, same_time):
        return 16.0 * np.exp(-np.sqrt(((a - b) ** 2).sum(axis=-1) + np.where(same_time, 0.0, off2)) / 3.0)

    for q in (0, 2, 3, 1):
        away = np.sqrt(((before[:, :3] - ears[q, :3]) ** 2).sum(axis=1))
        order = np.argsort(away, kind="stable")[:NEIGHBOURS]
        order = order[away[order] < REACH * SPREAD.correlation_m]
        k, place = order.size, before[order, :3]
        cov = shadow(place[:, None], place[None], now[order][:, None] & now[order][None])
        np.fill_diagonal(cov, 16.0 + own[q, :k])
        cross = shadow(place, ears[q, :3], now[order])
        solved = np.linalg.solve(cov, cross)
        assert near.count[q] == k
        assert near.ears[q, :k] == pytest.approx(before[order]) and not weights[q, k:].any()
        assert near.rss_dbm[q, :k] == pytest.approx(rss[order])
        assert weights[q, :k] == pytest.approx(solved, abs=1e-12)
        assert explained[q] == pytest.approx(solved @ cross, abs=1e-12)
        if d.heard[q]:
            before, rss = np.concatenate([before, ears[q : q + 1]]), np.append(rss, d.rss_dbm[q])
            now = np.append(now, True)


def test_what_one_receiver_reports_more_is_no_word_on_the_place_but_where_it_was_measured():
    """Two places by which the same receiver should read 6 dB apart; four readings elsewhere were 6 dB too strong."""
    d = detection([-62.0], [(0.0, 0.0)])
    points = np.array([[1.0, 0.0], [1.73, 0.0]])
    told = []
    for measured in ([], ["r0"]):
        still = ChannelSpread(2.0, 0.1, 1.0, transmitter_db=0.1, lobe_db=0.0)
        model, places = noise(still, Antenna(2.53, -62.0, 2.0, -80.0), (0.0,), 6.0, measured)
        away = np.array([[9.0, 0.0], [0.0, 9.0], [9.0, 9.0], [-9.0, 0.0]])
        # `REACH` correlation lengths of 1 m: brought near for the choice, by places that make no noise.
        earlier = earlier_at(
            model, 0.2 * away, -62.0 - 25.3 * np.log10(np.hypot(*(0.2 * away - points[1]).T)) + 6.0
        )
        log = places.log_likelihood(d, points, earlier)[0]
        told.append(log[1] - log[0])
    assert told[0] > 1.0 > 0.0 > told[1]


def test_the_next_reading_of_a_place_tells_little_of_the_distance():
    """What separates two distances by 10 dB at first separates them by half as much in the second reading."""
    model, places = noise(levels=(0.0,))
    d = detection([-62.0], [(0.0, 0.0)])
    points = np.array([[1.0, 0.0], [2.5, 0.0]])
    first = places.log_likelihood(d, points, NONE)[0]
    second = places.log_likelihood(d, points, earlier_at(model, [[0.0, 0.0]], [-62.0]))[0]
    assert second[0] - second[1] < 0.5 * (first[0] - first[1])


def test_silence_of_one_place_counts_less_the_longer_it_was():
    model, places = noise()
    exposure = np.zeros((model.power_db.size, 20, 20))
    ear = earlier_at(model, [[5.0, 5.0]], [0.0]).ears
    worth = []
    for _ in range(400):
        before = exposure[1].sum()
        places.listen(exposure, 0.5, ear, 1.0)
        worth.append(exposure[1].sum() - before)
    assert worth[0] > 1.2 * worth[-1] > 0.0
    alone = np.zeros_like(exposure)
    model, still = noise(ChannelSpread(ANTENNA.sigma_db, 0.0, 3.0, lobe_db=0.0))
    still.listen(alone, 0.5, ear, 1.0)
    twin = np.zeros_like(exposure)
    belief_model = LevelsModel(ANTENNA, LEVELS, 0.1)
    levels_loops.add_exposure(
        twin,
        0.5,
        np.array([[5.0, 5.0]]),
        belief_model.hear,
        belief_model.step2_m2,
        belief_model.limit2_m2,
        1.0,
    )
    assert alone == pytest.approx(twin, abs=2e-5)  # the reach ends where one packet in 100,000 is heard


@pytest.mark.parametrize("rate_hz", [3.0, 30.0, 1000.0])
def test_the_silence_of_busy_sources_is_a_number_and_counts_less_the_longer_it_was(rate_hz):
    """That a source of 30 packets a second is not heard for an hour has a probability below the smallest number."""
    model = LevelsModel(ANTENNA, LEVELS, 0.1)
    places = PlaceNoise(model, SPREAD, rate_hz)
    exposure = np.zeros((model.power_db.size, 20, 20))
    ear = earlier_at(model, [[5.0, 5.0]], [0.0]).ears
    worth = []
    for _ in range(60):
        before = exposure.sum()
        places.listen(exposure, 0.5, ear, 60.0)
        worth.append(exposure.sum() - before)
    assert np.isfinite(exposure).all() and (exposure >= 0.0).all()
    assert worth[0] > worth[-1] > 0.0


def test_neighbours_make_each_other_redundant():
    far = redundancy([np.array([[0.0, 0.0]]), np.array([[500.0, 0.0]])], SPREAD)
    near = redundancy([np.array([[0.0, 0.0]])] * 10, SPREAD)
    assert far == pytest.approx([1.0, 1.0]) and (near < 0.15).all()


def test_power_hypotheses_reach_as_far_as_shadows_do():
    assert levels_of(LEVELS, None) == LEVELS
    wide = levels_of(LEVELS, SPREAD)
    assert min(wide) < -11.0 and max(wide) > 3.0 and max(np.diff(wide)) <= 3.0


# The belief

SHORT = Antenna(2.53, float(-90.0 + 25.3 * np.log10(3.45)), float(np.hypot(2.0, 3.0)), -90.0)
PLACES = ChannelSpread(2.0, 3.0, 5.0, transmitter_db=0.1, lobe_db=0.0)


def engine(**changes):
    base = EngineSettings(
        Grid(12.0, 12.0, 0.5), SHORT, (("r0", "r1"),), (-4.0, -2.0, 0.0), spread=PLACES, found_within_m=1.0
    )
    return replace(base, **changes)


def fed(seed, n=30, settings=None):
    """Two robots abreast drive lanes over a source under shadowing."""
    rng = np.random.default_rng(seed)
    field = ShadowField(3.0, 5.0, rng)
    belief = IntensityBelief(settings or engine())
    source = np.array([6.5, 5.5])
    for k in range(n):
        east, north = 3.5 + 5.0 * rng.random(), 2.5 + 5.0 * rng.random()
        place = np.array([[east, north], [east + 1.5, north]])
        mean = SHORT.mean_rss_dbm(np.maximum(np.hypot(*(place - source).T), 0.05)) + field.at(place)
        z = np.round(mean + 2.0 * rng.standard_normal(2))
        belief.listen(Listening(20 * k * 10**9, 20 * (k + 1) * 10**9, ("r0", "r1"), place))
        z = np.where(z > SHORT.threshold_dbm, z, np.nan)
        if not np.isnan(z).all():
            belief.detect(detection(z.tolist(), place, t_ns=20 * k * 10**9))
    return belief, source


@pytest.mark.parametrize("seed", size([1], [1, 2, 3]))
def test_under_shadowing_one_source_stays_one_and_near(seed):
    belief, source = fed(seed)
    estimates = [each for each in belief.sources() if each.receptions > 2.0]
    assert len(estimates) == 1
    assert np.hypot(estimates[0].east_m - source[0], estimates[0].north_m - source[1]) < 1.0
    assert estimates[0].state == "found"


def test_the_same_calls_give_the_same_bits():
    assert fed(5, n=12)[0].digest() == fed(5, n=12)[0].digest()


def test_a_find_is_two_metres_or_a_tenth_of_the_range_where_places_make_noise():
    assert engine(spread=None, found_within_m=None).find_radius_m is None
    far = replace(SHORT, threshold_dbm=-140.0)
    assert engine(found_within_m=None, antenna=far).find_radius_m == pytest.approx(
        0.1 * float(far.nominal_range_m(-2.0))
    )
    # Of a radio that hears 2.9 m, "within 2 m" would say nothing.
    assert engine(found_within_m=None).find_radius_m == pytest.approx(
        float(SHORT.nominal_range_m(-2.0)) / 3.0
    )
    middling = replace(SHORT, threshold_dbm=-115.0)
    assert engine(found_within_m=None, antenna=middling).find_radius_m == pytest.approx(2.79, abs=0.02)
    assert engine(found_within_m=0.7).find_radius_m == 0.7


def test_a_source_heard_often_makes_no_other_be_forgotten():
    """The open detections are few here, so that it does not take three hundred packets."""
    few = Tuning().with_tables({"intensity": {"max_open": 36}})
    belief = IntensityBelief(engine(spread=None, found_within_m=None, tuning=few))
    rng = np.random.default_rng(9)

    def packets(source, count):
        for _ in range(count):
            place = source + rng.uniform(-1.5, 1.5, 2)
            mean = SHORT.mean_rss_dbm(max(0.3, float(np.hypot(*(place - source)))))
            z = round(float(mean + rng.normal(0.0, 3.0)))
            if z > SHORT.threshold_dbm:
                belief.detect(detection([float(z)], [tuple(place)]))

    packets(np.array([3.0, 3.0]), 14)
    packets(np.array([9.0, 9.0]), 45)
    near = [each for each in belief.sources() if np.hypot(each.east_m - 3.0, each.north_m - 3.0) < 1.0]
    assert len(belief.mixture.open) <= 36
    most = max(near, key=lambda each: each.receptions)
    assert most.p_exists > 0.99
    # Its detections are open still: it can be divided, re-estimated and merged.
    kept = next(c for c in belief.candidates if c.ident == most.ident)
    assert kept.receptions - kept.frozen_receptions > 6.0


def test_frozen_detections_still_count_as_evidence_for_a_source():
    belief, _ = fed(1, n=12, settings=engine(spread=None, found_within_m=None))
    (candidate,) = [c for c in belief.candidates if c.receptions > 3.0]
    before = next(each.p_exists for each in belief.sources() if each.ident == candidate.ident)
    for number in list(candidate.responsibility):
        candidate.forget(number)
    after = next(each.p_exists for each in belief.sources() if each.ident == candidate.ident)
    assert after == pytest.approx(before, abs=1e-12) and before > 0.99


def test_positions_that_err_together_are_not_averaged_out_within_a_minute():
    """The same readings: within three minutes they share an error of 2 m, over many they share about its twentieth."""
    spread = {}
    for apart_s in (1, 180):
        belief, rng = IntensityBelief(engine(spread=None, pose_sigma_m=2.0)), np.random.default_rng(3)
        for k in range(20):
            place = np.array([6.0, 6.0]) + rng.uniform(-1.5, 1.5, 2)
            z = round(float(SHORT.mean_rss_dbm(max(0.3, float(np.hypot(*(place - 6.0)))))))
            belief.detect(detection([float(z)], [tuple(place)], t_ns=apart_s * k * 10**9))
        best = max(belief.sources(), key=lambda each: each.receptions)
        spread[apart_s] = (np.sqrt(np.trace(best.cov_m2)), best.p_here, best.region_90)
    assert spread[1][0] ** 2 - spread[180][0] ** 2 == pytest.approx(2.0 * 4.0 * (1.0 - 1.0 / 20.0), abs=0.1)
    assert spread[1][1] < spread[180][1] and spread[1][2] > spread[180][2]
