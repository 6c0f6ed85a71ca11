"""Clouds and ground in coarse points where ranges are long: what is said of a source hardly depends on how coarse."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fieldkit.channel.model import Antenna
from fieldkit.engine.belief.intensity.belief import IntensityBelief
from fieldkit.engine.belief.intensity.births import is_coarse
from fieldkit.engine.belief.intensity.ground import BLURRED, ground_of
from fieldkit.engine.belief.intensity.mixture import Mixture
from fieldkit.engine.grid import Grid
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Detection, Listening
from fieldkit.tuning import IntensityTuning, Tuning
from fieldkit.world.channel import sample_rss_dbm

RANGE_M = 300.0
ANTENNA = Antenna(2.53, -90.0 + 25.3 * float(np.log10(RANGE_M)), 3.3, -90.0)
SOURCE_M = np.array([420.0, 610.0])


def field(cell_m: float, **tuning: int) -> EngineSettings:
    return EngineSettings(
        Grid(1_000.0, 1_000.0, cell_m),
        ANTENNA,
        (("r0",), ("r1",), ("r2",)),
        tuning=Tuning(intensity=replace(IntensityTuning(), **tuning)),
    )


def after(engine: EngineSettings, packets: int) -> IntensityBelief:
    """A belief that has heard one source so often, from all around it."""
    belief, rng = IntensityBelief(engine), np.random.default_rng(4)
    for k in range(packets):
        at = SOURCE_M + rng.uniform(-250.0, 250.0, (3, 2))
        belief.listen(Listening(k * 10**10, (k + 1) * 10**10, engine.robots, at))
        rss = sample_rss_dbm(ANTENNA, np.hypot(*(at - SOURCE_M).T), 0.0, rng)
        belief.detect(
            Detection((k + 1) * 10**10, engine.robots, at, np.zeros(3), rss, np.zeros(3, dtype=bool))
        )
    return belief


@pytest.mark.parametrize("packets", [3, 8])
def test_coarse_clouds_say_what_fine_ones_say(packets: int) -> None:
    coarse, fine = (
        after(field(10.0, refine_points=most, blurred_points=most), packets) for most in (12, 2_000)
    )
    (one,), (other,) = coarse.candidates, fine.candidates
    assert one.spacing_m > 1.5 * other.spacing_m and len(one.points_m) < 0.5 * len(other.points_m)
    (rough,), (exact,) = coarse.sources(), fine.sources()
    sigma_m = float(np.sqrt(np.trace(exact.cov_m2) / 2.0))
    assert np.hypot(rough.east_m - exact.east_m, rough.north_m - exact.north_m) < 0.15 * sigma_m
    assert np.sqrt(np.trace(rough.cov_m2) / 2.0) == pytest.approx(sigma_m, rel=0.1)
    assert rough.region_90 == pytest.approx(exact.region_90, rel=0.25, abs=4)
    assert coarse.presence().sum() == pytest.approx(fine.presence().sum(), rel=0.02)


def test_ground_is_no_finer_than_hearing_over_such_ranges_is_sharp() -> None:
    by_cell = {cell_m: ground_of(field(cell_m), 6_000) for cell_m in (2.0, 5.0, 10.0)}
    for cell_m, ground in by_cell.items():
        assert ground.grid.cell_m <= max(BLURRED * RANGE_M, 2.0 * cell_m)
        assert ground.grid.n_cells < 15_000
        assert ground.of_field(np.zeros(ground.grid.shape)).shape == field(cell_m).grid.shape
    assert by_cell[5.0].factor == 3


def test_points_are_refined_sooner_where_they_are_further_apart_than_hearing_is_sharp() -> None:
    short = Antenna(2.53, -90.0 + 25.3 * float(np.log10(3.45)), 3.3, -90.0)
    engines = field(5.0), replace(field(10.0), grid=Grid(50.0, 50.0, 0.5), antenna=short)
    wide, sharp = (Mixture(engine) for engine in engines)
    for mixture, few in ((wide, 100), (sharp, 300)):
        cell_m = mixture.grid.cell_m
        for count, is_due in ((few, True), (few + 1, False)):
            cloud = SimpleNamespace(spacing_m=cell_m, points_m=np.zeros((count, 2)))
            assert is_coarse(mixture, cloud) is is_due  # type: ignore[arg-type]


def test_ground_in_small_cells_stays_where_ranges_are_short() -> None:
    short = Antenna(2.53, -90.0 + 25.3 * float(np.log10(3.45)), 3.3, -90.0)
    engine = replace(field(10.0), grid=Grid(50.0, 50.0, 0.5), antenna=short)
    assert ground_of(engine, 6_000).factor == 1
