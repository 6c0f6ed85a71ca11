"""Teams and inputs out of the ordinary: one robot, many robots, repeats, absurd values, a belief brought back."""

from dataclasses import replace

import numpy as np
import pytest

from fieldkit.engine.belief.intensity.belief import IntensityBelief
from fieldkit.errors import ConfigError
from fieldkit.messages import Detection, Pose, RssReading, Tick, VehicleState
from fieldkit.world.sources import TransientSource
from mission.core.kernel import Kernel
from mission.core.kernel_settings import KernelSettings
from mission.lab.bench import random_detection, settings
from mission.lab.simulate import Truth, simulate
from mission.lab.study.trust import antenna
from mission.lab.study.trust import settings as study_settings

S = 1_000_000_000


def test_one_robot_alone_finds_a_source_only_slower() -> None:
    engine = replace(study_settings(3), teams=(("r0",),))
    truth = Truth(antenna(), (TransientSource(9.0, 8.0, -2.0, 0.1),), ((5.0, 5.0),))
    result = simulate(KernelSettings(engine, max_duration_s=4000.0), truth, 3)
    assert result.time_to_all_s is not None
    assert result.false_finds == 0


def test_sixty_four_robots_are_one_team_sheet_like_any_other() -> None:
    engine = replace(study_settings(1), teams=tuple((f"a{k}", f"b{k}") for k in range(32)))
    start = tuple((0.6 + 0.75 * k, 0.6 + 1.0 * side) for k in range(32) for side in (0, 1))
    truth = Truth(antenna(), (TransientSource(12.0, 12.0, -2.0, 0.2),), start)
    result = simulate(KernelSettings(engine, max_duration_s=90.0), truth, 1)
    assert np.isfinite(result.kernel.belief.presence()).all()
    assert result.kernel.detections > 0


def test_no_robots_are_no_mission() -> None:
    kernel = Kernel(KernelSettings(replace(study_settings(1), teams=()), max_duration_s=10.0))
    assert kernel.step(Tick(0)).commands == ()


def test_a_transmission_told_twice_does_not_make_two_sources() -> None:
    engine = settings(sensing="levels")
    belief = IntensityBelief(engine)
    detection = random_detection(engine, np.random.default_rng(0), 3)
    belief.detect(detection)
    belief.detect(detection)
    assert len([c for c in belief.candidates if c.receptions > 1.0]) <= 1


def test_detections_out_of_order_give_a_proper_belief() -> None:
    engine = settings(sensing="levels")
    rng = np.random.default_rng(4)
    told = [replace(random_detection(engine, rng, 2), t_ns=k * S) for k in (5, 1, 3, 2)]
    belief = IntensityBelief(engine)
    for detection in told:
        belief.detect(detection)
    presence = belief.presence()
    assert np.isfinite(presence).all() and presence.max() <= 1.0


def test_robots_far_outside_the_grid_change_nothing_within() -> None:
    engine = settings(sensing="levels")
    belief = IntensityBelief(engine)
    before = belief.presence()
    m = len(engine.robots)
    far = Detection(
        0,
        engine.robots,
        np.full((m, 2), 9000.0),
        np.zeros(m),
        np.r_[-70.0, np.full(m - 1, np.nan)],
        np.zeros(m, bool),
    )
    belief.detect(far)
    assert np.isfinite(belief.presence()).all()
    assert belief.presence()[:40, :40] == pytest.approx(before[:40, :40], abs=1e-3)


def test_absurd_events_leave_the_kernel_standing() -> None:
    kernel = Kernel(KernelSettings(study_settings(1)))
    for event in (
        RssReading(0, "r0", float("nan")),
        RssReading(-5 * S, "r0", -60.0),
        RssReading(10**18, "r0", 9999.0),
        Pose(0, "r0", 1.0, 1.0),
        Pose(0, "r0", 1.0, 1.0),
        VehicleState(0, "r0", "unknown", False),
        Tick(S),
        Tick(S),
        Tick(0),
    ):
        kernel.step(event)
    assert np.isfinite(kernel.belief.presence()).all()


def test_settings_that_make_no_sense_are_refused() -> None:
    for change in (
        {"power_levels_db": ()},
        {"found_probability": 1.0},
        {"reference_rate_hz": 0.0},
        {"max_speed_m_s": -1.0},
    ):
        with pytest.raises(ConfigError, match=next(iter(change))):
            replace(settings(), **change)  # type: ignore[arg-type]
