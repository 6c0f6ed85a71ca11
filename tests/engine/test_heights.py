"""Receivers above the ground, with antennas and thresholds of their own: laws, plain twins, and missions in the air."""

from dataclasses import replace

import numpy as np
import pytest
from sizes import size

from fieldkit.channel.antenna_file import Receiver
from fieldkit.channel.model import Antenna
from fieldkit.channel.pattern import lobe_gain_db
from fieldkit.channel.spread import ChannelSpread
from fieldkit.engine.belief.intensity.belief import IntensityBelief
from fieldkit.engine.grid import Grid
from fieldkit.engine.likelihood import levels_loops
from fieldkit.engine.likelihood.ears import Ears
from fieldkit.engine.likelihood.levels import LevelsModel
from fieldkit.engine.likelihood.places import NOTHING_EARLIER, PlaceNoise
from fieldkit.engine.planning import path_loops
from fieldkit.engine.planning.reward import hearing_of
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Detection, Listening, Pose, Tick, VehicleState
from fieldkit.world.sources import TransientSource
from mission.core.kernel import Kernel, KernelSettings
from mission.lab.simulate import Truth, simulate

RADIO = Antenna(2.5, -50.0, 3.0, -85.0)
LOBE = tuple(np.round(lobe_gain_db(np.arange(0.0, 360.0, 10.0), 0.0, 1.0, -12.0), 3).tolist())
NONE = np.empty(0)


def heard(rss, position, up_m, robots=("a",), heading_deg=0.0):
    m = len(robots)
    return Detection(
        0,
        robots,
        np.array(position, dtype=float).reshape(m, 2),
        np.full(m, heading_deg),
        np.array(rss, dtype=float),
        np.zeros(m, dtype=bool),
        up_m=np.array(up_m, dtype=float),
    )


@pytest.mark.parametrize("beta", [2.0, 2.7])
def test_twice_as_far_in_three_dimensions_loses_ten_beta_log_two(beta: float) -> None:
    ears = Ears(replace(RADIO, path_loss_exponent=beta))
    near = ears.of(("a",), np.array([[3.0, 0.0]]), np.array([4.0]), NONE, NONE)
    far = ears.of(("a",), np.array([[6.0, 0.0]]), np.array([8.0]), NONE, NONE)
    source = np.zeros((1, 2))
    more = ears.attenuation_db(source, far) - ears.attenuation_db(source, near)
    assert more[0, 0] == pytest.approx(10.0 * beta * np.log10(2.0), abs=1e-9)


def test_the_source_height_counts_as_the_receivers_does() -> None:
    up, down = Ears(RADIO, source_up_m=0.0), Ears(RADIO, source_up_m=30.0)
    place, source = np.array([[3.0, 0.0]]), np.zeros((1, 2))
    one = up.attenuation_db(source, up.of(("a",), place, np.array([10.0]), NONE, NONE))
    other = down.attenuation_db(source, down.of(("a",), place, np.array([40.0]), NONE, NONE))
    assert one == pytest.approx(other, abs=1e-12)


def test_two_vertical_dipoles_hear_nothing_of_each_other_overhead_but_for_the_floor() -> None:
    ears, plain = Ears(RADIO, elevation=2.0), Ears(RADIO)
    at = ears.of(("a", "b"), np.array([[0.0, 0.0], [10.0, 0.0]]), np.array([10.0, 10.0]), NONE, NONE)
    lost = ears.attenuation_db(np.zeros((1, 2)), at) - plain.attenuation_db(np.zeros((1, 2)), at)
    assert lost[0] == pytest.approx([40.0, 40.0 * np.log10(np.sqrt(2.0))], abs=1e-9)


@pytest.mark.parametrize("pattern", [(), LOBE])
@pytest.mark.parametrize("spread", [None, ChannelSpread(2.0, 2.2, 3.0, lobe_db=0.0)])
def test_the_compiled_likelihood_agrees_with_its_plain_form(pattern, spread) -> None:
    """A silent, a heard and a heard robot at their heights: alone, the plain attenuation is all that is new."""
    radio = replace(RADIO, pattern_db=pattern)
    ears = Ears(radio, 1.0, 1.5, {"b": Receiver(4.0, -80.0)}, 0.1)
    model = LevelsModel(radio, (0.0,), 0.1, ears=ears)
    points = np.random.default_rng(0).uniform(0.0, 30.0, (40, 2))
    flat = LevelsModel(RADIO, (0.0,), 0.1, ears=Ears(RADIO, point_sigma_m=0.1))
    for robot, rss, up_m, heading in (
        ("a", -70.0, 10.0, 70.0),
        ("b", -66.0, 0.0, 0.0),
        ("b", np.nan, 9.0, 200.0),
    ):
        d = ears.corrected(heard([rss], [5.0, 7.0], [up_m], (robot,), heading))
        ours = (
            model.log_likelihood(d, points)
            if spread is None
            else PlaceNoise(model, spread, 0.1).log_likelihood(d, points, NOTHING_EARLIER)
        )[0]
        loss = ears.attenuation_db(points, ears.of_detection(d))[:, 0]
        # The same, as a radio on the ground of the source would hear it, at a distance that loses as much: but for
        # the smear of an unsure place, which a distance sets that is another one.
        threshold = -80.0 - 4.0 if robot == "b" else -85.0
        reading = rss - 4.0 if robot == "b" else rss
        sigma = 3.0 if spread is None else float(np.hypot(2.0, 2.2))
        twin = _alone(reading, -50.0 - loss, sigma, threshold, flat)
        assert ours == pytest.approx(twin, abs=0.02)


def _alone(rss, mean, sigma, threshold, model):
    from scipy.stats import norm

    t = model.tuning
    if np.isnan(rss):
        return np.log(t.packet_loss + (1 - t.packet_loss) * norm.cdf(threshold + 0.5, mean, sigma))
    wide = np.sqrt(sigma**2 + 1.0 / 12.0)
    return np.log(
        (1 - t.packet_loss)
        * (
            (1 - t.outliers) * norm.pdf(rss, mean, wide)
            + t.outliers * norm.pdf(rss, mean, t.outlier_width * wide)
        )
    )


@pytest.mark.parametrize("pattern", [(), LOBE])
def test_exposure_from_above_agrees_with_a_plain_twin(pattern) -> None:
    radio = replace(RADIO, pattern_db=pattern, threshold_dbm=-75.0)
    ears = Ears(radio, 0.0, 2.0, {"b": Receiver(0.0, -70.0)}, 0.1)
    model = LevelsModel(radio, (-3.0, 0.0), 0.1, ears=ears)
    listening = Listening(
        0,
        2 * 10**9,
        ("a", "b"),
        np.array([[4.0, 4.0], [12.0, 9.0]]),
        np.array([6.0, 0.0]),
        np.array([30.0, 300.0]),
    )
    rows = ears.of_listening(listening)
    exposure = np.zeros((model.level_dbm.size, 20, 20))
    levels_loops.add_exposure_of_ears(
        exposure, 1.0, rows, np.zeros(2, dtype=np.int64), model.hear[None], model.step2_m2, model.limit2_m2,
        radio.threshold_dbm, ears.law, ears.pattern_db, ears.best_db, 2.0,
    )  # fmt: skip
    loss = ears.attenuation_db(Grid(20.0, 20.0, 1.0).centres_m, rows)
    margin = (model.level_dbm[:, None, None] - loss - rows[:, 4] - 0.5) / radio.sigma_db
    from scipy.stats import norm

    silent = np.prod(1.0 - (1.0 - model.tuning.packet_loss) * norm.cdf(margin), axis=-1)
    assert exposure.reshape(model.level_dbm.size, -1) == pytest.approx(2.0 * (1.0 - silent), abs=0.02)


def test_a_planned_path_is_heard_from_as_far_as_exposure_is() -> None:
    settings = EngineSettings(
        Grid(30.0, 30.0, 1.0), RADIO, (("a", "b"),), spread=ChannelSpread(2.0, 2.0, 3.0, elevation=2.0),
        receivers={"b": Receiver(3.0, -80.0)},
    )  # fmt: skip
    ears = hearing_of(settings, ("a", "b"), {"a": 10.0})
    true = Ears(RADIO, 0.0, 2.0, settings.receivers)
    rows = true.of(("a", "b"), np.zeros((2, 2)), np.array([10.0, 0.0]), NONE, NONE)
    for away in (0.0, 1.0, 5.0, 20.0):
        loss = true.attenuation_db(np.array([[0.0, away]]), rows)[0] + rows[:, 4] - RADIO.threshold_dbm
        far2 = [path_loops.as_far2(away**2, ears, q) for q in range(2)]
        if away > 0.0:
            assert 12.5 * np.log10(far2) == pytest.approx(loss, abs=1e-9)
        assert far2[0] >= 100.0


def test_an_insensitive_robots_own_threshold_makes_its_silence_say_less() -> None:
    def exposed(receivers):
        belief = IntensityBelief(
            EngineSettings(
                Grid(40.0, 40.0, 1.0), RADIO, (("a",),), receivers=receivers, reference_rate_hz=0.1
            )
        )
        belief.listen(Listening(0, 60 * 10**9, ("a",), np.array([[20.0, 20.0]])))
        return belief.exposure_s[0].sum()

    assert exposed({"a": Receiver(0.0, -70.0)}) < 0.2 * exposed({})
    assert exposed({"a": Receiver(-15.0, -85.0)}) == pytest.approx(
        exposed({"a": Receiver(0.0, -70.0)}), rel=1e-9
    )


def test_a_known_offset_leaves_the_find_where_it_was() -> None:
    def found(offset_db):
        settings = EngineSettings(
            Grid(20.0, 20.0, 0.5), RADIO, (("a",),), receivers={"a": Receiver(offset_db)} if offset_db else {}
        )
        belief, rng = IntensityBelief(settings), np.random.default_rng(3)
        for k in range(12):
            place = rng.uniform(4.0, 16.0, 2)
            z = np.round(RADIO.mean_rss_dbm(float(np.hypot(*(place - (9.0, 11.0))))) + rng.normal(0.0, 3.0))
            belief.detect(replace(heard([z + offset_db], place, [0.0]), t_ns=k * 10**9))
        return belief.sources()[0]

    plain, shifted = found(0.0), found(9.0)
    assert (plain.east_m, plain.north_m) == (shifted.east_m, shifted.north_m)


def test_positions_without_a_height_are_none_of_a_robot_that_flies() -> None:
    settings = EngineSettings(Grid(20.0, 20.0, 1.0), RADIO, (("a",), ("b",)))
    kernel = Kernel(KernelSettings(settings, altitude_m={"b": 12.0}))
    kernel.step(VehicleState(0, "b", "guided", True))
    said = [kernel.step(Pose(k, "b", 1.0, 1.0, origin="camera")).notes for k in (1, 2)]
    assert "b: it flies, and its positions (camera) have no height" in said[0][0] and said[1] == ()
    kernel.step(Pose(3, "a", 1.0, 1.0, origin="camera"))
    kernel.step(Tick(10**9))
    assert set(kernel.associator.without_height) == {"b"}


def flown(seed: int, *, up_m: tuple[float, ...], side_m: float, power_dbm: float, sources, cap_s: float):
    radio = Antenna(2.5, power_dbm, 3.0, -85.0)
    robots = tuple(f"r{k}" for k in range(len(up_m)))
    engine = EngineSettings(
        Grid(side_m, side_m, side_m / 50.0),
        radio,
        tuple((robot,) for robot in robots),
        reference_rate_hz=0.2,
        max_speed_m_s=side_m / 40.0,
        seed=seed,
        spread=ChannelSpread(2.1, 2.1, 2.0, transmitter_db=0.1, elevation=2.0),
        found_within_m=side_m / 20.0,
    )
    truth = Truth(
        radio,
        tuple(TransientSource(east, north, 0.0, 0.2) for east, north in sources),
        tuple((0.2 * side_m + 0.1 * side_m * k, 0.1 * side_m) for k in range(len(up_m))),
        max_speed_m_s=side_m / 40.0,
        elevation=2.0,
    )
    heights = {robot: up for robot, up in zip(robots, up_m, strict=True) if up > 0.0}
    kernel = KernelSettings(engine, altitude_m=heights, max_duration_s=cap_s, sources_expected=len(sources))
    return simulate(kernel, truth, seed)


@pytest.mark.parametrize("seed", size([2], [1, 2]))
def test_rovers_and_copters_at_two_heights_find_what_is_on_the_ground(seed: int) -> None:
    sources = ((12.0, 28.0), (30.0, 14.0), (21.0, 21.0))
    result = flown(
        seed, up_m=(0.0, 0.0, 10.0, 13.0), side_m=40.0, power_dbm=-50.0, sources=sources, cap_s=900.0
    )
    finds = [s for s in result.kernel.sources() if s.state == "found"]
    assert len(finds) == 3
    for find in finds:
        assert min(np.hypot(find.east_m - e, find.north_m - n) for e, n in sources) < 3.0
