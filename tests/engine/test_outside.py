"""Sources beyond the border: heard inside, and said to be outside; never drawn to the border."""

from dataclasses import replace

import numpy as np
import pytest
from sizes import size

from fieldkit.channel.spread import assumed, known_power
from fieldkit.engine.belief.intensity.belief import IntensityBelief
from fieldkit.engine.belief.intensity.ground import ground_of
from fieldkit.engine.grid import Grid
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Detection, Listening
from mission.lab.study.trust import antenna

RADIO = antenna()
FIELD = EngineSettings(
    Grid(12.0, 12.0, 0.5),
    RADIO,
    (("a", "b"),),
    (0.0,),
    spread=replace(known_power(assumed(RADIO)), receiver_db=0.0, lobe_db=0.0),
    found_within_m=1.0,
)
S = 1_000_000_000


def searched(source: tuple[float, float], seed: int, rounds: int = 120) -> IntensityBelief:
    """Two robots anywhere in the field, the whole of it; a transmission every ten seconds."""
    belief, rng = IntensityBelief(FIELD), np.random.default_rng(seed)
    for k in range(rounds):
        place = rng.uniform(0.3, 11.7, (2, 2))
        belief.listen(Listening(10 * k * S, 10 * (k + 1) * S, ("a", "b"), place))
        z = np.round(RADIO.mean_rss_dbm(np.hypot(*(place - source).T)) + rng.normal(0.0, RADIO.sigma_db, 2))
        z = np.where(z > RADIO.threshold_dbm, z, np.nan)
        if not np.isnan(z).all():
            belief.detect(Detection(10 * k * S, ("a", "b"), place, np.zeros(2), z, np.zeros(2, bool)))
    return belief


@pytest.mark.parametrize("seed", size([1], [1, 2, 3]))
def test_a_source_two_metres_outside_is_said_to_be_outside(seed: int) -> None:
    belief = searched((14.0, 6.0), seed)
    heard = [each for each in belief.sources() if each.receptions > 2.5]
    assert [each.state for each in heard] == ["outside"]
    assert heard[0].east_m > 12.0 and "outside the field" in heard[0].note
    assert np.hypot(heard[0].east_m - 14.0, heard[0].north_m - 6.0) < 2.0
    assert belief.probability_left() < 0.3  # it is none of the field's own


@pytest.mark.parametrize("seed", size([1], [1, 2, 3]))
def test_a_source_just_inside_is_found_inside(seed: int) -> None:
    belief = searched((11.0, 6.0), seed)
    (found,) = [each for each in belief.sources() if each.state == "found"]
    assert np.hypot(found.east_m - 11.0, found.north_m - 6.0) < 1.0


@pytest.mark.parametrize("seed", size([1, 3], [1, 2, 3, 4]))
def test_a_source_on_the_border_is_found_and_not_outside(seed: int) -> None:
    belief = searched((12.0, 6.0), seed)
    heard = [each for each in belief.sources() if each.receptions > 2.5]
    assert [each.state for each in heard] == ["found"]
    assert np.hypot(heard[0].east_m - 12.0, heard[0].north_m - 6.0) < 1.0


def test_how_far_beyond_is_said_in_decimetres_where_it_is_near() -> None:
    ground = ground_of(FIELD, 10_000)
    assert "about 0.7 m beyond" in ground.said_of(np.array([12.7, 6.0]))
    assert "about 3 m beyond" in ground.said_of(np.array([15.0, 6.0]))


def test_what_planners_and_pages_see_is_of_the_fields_own_shape() -> None:
    belief = searched((14.0, 6.0), 1, rounds=20)
    for values in (belief.presence(), belief.activity(), belief.ground_value(), belief.exposure_s[0]):
        assert values.shape == FIELD.grid.shape and np.isfinite(values).all()
    assert belief.activity().sum() == pytest.approx(1.0)


@pytest.mark.parametrize("most", [100_000, 3_000, 900])
def test_the_ground_reaches_one_longest_range_beyond_in_as_few_cells_as_allowed(most: int) -> None:
    settings = replace(FIELD, grid=Grid(12.0, 8.0, 0.5), power_levels_db=(-4.0, 3.0))
    ground = ground_of(settings, most)
    reach_m = float(RADIO.nominal_range_m(3.0))
    grid = ground.grid
    assert grid.west_m <= -reach_m and grid.south_m + grid.size_north_m >= 8.0 + reach_m
    assert grid.n_cells <= max(most, 2 * settings.grid.n_cells) and grid.n_cells * ground.sources_a_cell > 1.0
    middles = np.zeros(grid.shape)
    middles[:] = grid.east_m
    assert np.abs(ground.of_field(middles) - settings.grid.east_m).max() <= grid.cell_m / 2
    assert grid.cell_of(*grid.centres_m[17]) == (17 // grid.n_east, 17 % grid.n_east)


def test_a_field_whose_corner_is_not_the_origin_is_searched_as_any_other() -> None:
    """The part of a wide ground that a belief is of lies where it lies."""
    corner_m = np.array([100.0, -40.0])
    believed = []
    for at_m in (np.zeros(2), corner_m):
        rng = np.random.default_rng(3)
        grid = replace(FIELD.grid, west_m=float(at_m[0]), south_m=float(at_m[1]))
        belief = IntensityBelief(replace(FIELD, grid=grid))
        for k in range(30):
            place = rng.uniform(0.0, 12.0, (2, 2))
            z = RADIO.mean_rss_dbm(np.hypot(*(place - (4.0, 7.0)).T), 0.0) + rng.normal(0.0, 2.0, 2)
            z = np.where(np.round(z) > RADIO.threshold_dbm, np.round(z), np.nan)
            zero = np.zeros(2)
            belief.listen(Listening(10 * k * S, 10 * (k + 1) * S, ("a", "b"), at_m + place, zero, zero, zero))
            if not np.isnan(z).all():
                belief.detect(Detection(10 * k * S, ("a", "b"), at_m + place, zero, z, zero > 0.0))
        believed.append(belief)
    here, there = believed
    mine, theirs = here.sources(), there.sources()
    assert [each.state for each in mine] == [each.state for each in theirs] and mine
    for one, other in zip(mine, theirs, strict=True):
        assert (other.east_m - 100.0, other.north_m + 40.0) == pytest.approx(
            (one.east_m, one.north_m), abs=0.05
        )
    assert there.presence() == pytest.approx(here.presence(), abs=0.05)
    assert "about 0.7 m beyond" in there.mixture.ground.said_of(np.array([112.7, -34.0]))
