"""A mission file that is wrong says so: file, key path, what was expected, what was there."""

from pathlib import Path

import pytest

from fieldkit import plugins
from fieldkit.engine.planning.dprwa import DprwaPlanner
from fieldkit.errors import ConfigError
from mission.core.mission_file import read_mission
from mission.core.template import mission_text
from mission.lab.synthetic import small_mission
from mission.shell.preflight import judge_calibration


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    small_mission(tmp_path)
    return tmp_path


def change(folder: Path, old: str, new: str) -> Path:
    path = folder / "mission.toml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    return path


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("cell_m = 0.2", "cell_m = -1", ["field.cell_m", "greater than 0", "-1"]),
        ("cell_m = 0.2", 'cell_m = "small"', ["field.cell_m", "number", "'small'"]),
        ("cell_m = 0.2", "cell_m = 0.0001", ["cell_m", "4,000,000"]),
        ("cell_m = 0.2", "cell_meters = 0.2", ["field.cell_meters", "no such key"]),
        ('belief = "intensity"', 'belief = "oracle"', ["engine.belief", "intensity", "spog", "'oracle'"]),
        ('driver = "xbee"', 'driver = "xbox"', ["receiver.driver", "xbee", "'xbox'"]),
        (
            "schema = 1",
            'schema = 1\npositions = [{driver = "crystal ball"}]',
            ["positions.0.driver", "crystal ball"],
        ),
        ("[engine]", "[engine]\ngroup_gap_m = 0", ["engine.group_gap_m", "greater than 0", "0"]),
        ("[engine]", '[engine]\nsensing = "ears"', ["engine.sensing", "pairwise", "'ears'"]),
        ("schema = 1", "schema = 7", ["schema", "newer", "update"]),
        ("schema = 1", "schema = [", ["TOML"]),
        ("system_id = 2", "system_id = 1", ["'r2'", "system_id", "'r1'"]),
        ('port = "port2"', 'port = "port1"', ["'r2'", "port1", "'r1'"]),
        ('robots = ["r1", "r2"]', 'robots = ["r1", "r9"]', ["r9", "r1"]),
        ('robots = ["r1", "r2"]', 'robots = ["r1"]', ["r2", "no team"]),
        ('name = "r2"', 'name = "r1"', ["'r1'", "2 robots"]),
        ('file = "antenna.toml"', 'file = "lost.toml"', ["lost.toml", "fieldkit calibrate fit"]),
    ],
)
def test_each_mistake_is_named_with_its_place(folder: Path, old: str, new: str, words: list[str]) -> None:
    path = change(folder, old, new)
    with pytest.raises(ConfigError) as caught:
        read_mission(path)
    message = str(caught.value)
    for word in [*words, str(folder)]:
        assert word in message


def test_options_of_the_papers_planners_reach_them(folder: Path) -> None:
    assert read_mission(folder / "mission.toml").kernel.engine.group_gap_m == float("inf")
    path = change(folder, "[engine]", "[engine]\ngroup_gap_m = 8.5\nnormalised_entropy = true")
    path = change(folder, 'planner = "infogain"', 'planner = "dprwa"')
    mission = read_mission(path)
    assert mission.kernel.engine.group_gap_m == 8.5 and mission.kernel.engine.normalised_entropy
    planner = plugins.load("fieldkit.planners", mission.kernel.planner)(mission.kernel.engine)
    assert isinstance(planner, DprwaPlanner) and planner.settings.group_gap_m == 8.5


def test_a_missing_file_says_how_to_get_one(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="fieldkit new"):
        read_mission(tmp_path / "nothing.toml")


def test_a_refused_calibration_stops_the_mission_unless_told_otherwise(folder: Path) -> None:
    antenna = folder / "antenna.toml"
    antenna.write_text(antenna.read_text().replace('state = "accepted"', 'state = "refused"'))
    with pytest.raises(ConfigError, match="refused"):
        read_mission(folder / "mission.toml")
    change(folder, 'file = "antenna.toml"', 'allow_refused = true\nfile = "antenna.toml"')
    assert read_mission(folder / "mission.toml").antenna.verdict == "refused"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("sigma_db = 3.3", "sigma_db = -3.3", ["parameters.sigma_db", "positive"]),
        ("sigma_db = 3.3", "sigma_db = nan", ["parameters.sigma_db", "finite"]),
        ("threshold_dbm = -70.0", "", ["parameters.threshold_dbm", "None"]),
        ("schema = ", "schema = 9", ["schema", "newer"]),
    ],
)
def test_a_bad_antenna_file_is_named_too(folder: Path, old: str, new: str, words: list[str]) -> None:
    path = folder / "antenna.toml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(ConfigError) as caught:
        read_mission(folder / "mission.toml")
    for word in [*words, "antenna.toml"]:
        assert word in str(caught.value)


def test_what_new_writes_needs_nothing_but_an_antenna_file(folder: Path) -> None:
    path = folder / "mine.toml"
    path.write_text(mission_text())
    mission = read_mission(path)
    assert mission.kernel.stop_probability_left == 0.05
    assert len(mission.kernel.engine.robots) == 4


def test_the_calibrations_own_uncertainty_widens_the_engines_sigma(folder: Path) -> None:
    before = read_mission(folder / "mission.toml").kernel.engine.antenna.sigma_db
    antenna = folder / "antenna.toml"
    antenna.write_text(
        antenna.read_text()
        + """
[covariance]
names = ["power_at_1m_dbm", "path_loss_exponent", "sigma_db"]
matrix = [[4.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
"""
    )
    widened = read_mission(folder / "mission.toml").kernel.engine.antenna.sigma_db
    assert before == pytest.approx(3.3)
    assert widened == pytest.approx((3.3**2 + 4.0) ** 0.5)


def test_place_noise_is_assumed_where_the_antenna_file_tells_none_and_preflight_says_so(folder: Path) -> None:
    mission = read_mission(folder / "mission.toml")
    spread = mission.kernel.engine.spread
    assert spread is not None and spread.sigma_place_db > 1.0 and spread.transmitter_db < 1.0
    (said,) = [check for check in judge_calibration(mission, 0) if check.name == "place noise"]
    assert (
        said.level == "amber"
        and "2.3 dB from place to place over 1 m and by direction are assumed" in said.found
    )
    change(folder, "power_levels_db = ", "# power_levels_db = ")
    unknown = read_mission(folder / "mission.toml").kernel.engine.spread
    assert (
        unknown is not None
        and unknown.transmitter_db == 10.0
        and "power is taken for unknown" in unknown.assumed
    )


def test_place_noise_can_be_left_out(folder: Path) -> None:
    change(folder, "[engine]", "[engine]\nplace_noise = false")
    assert read_mission(folder / "mission.toml").kernel.engine.spread is None


def test_place_noise_is_taken_from_an_antenna_file_that_has_measured_it(folder: Path) -> None:
    change(folder, "[engine]", "[engine]\nfound_within_m = 1.5")
    antenna = folder / "antenna.toml"
    antenna.write_text(
        antenna.read_text() + "\n[channel]\nsigma_time_db = 2.0\nsigma_place_db = 3.0\ncorrelation_m = 4.0\n"
    )
    engine = read_mission(folder / "mission.toml").kernel.engine
    assert engine.place_noise and engine.find_radius_m == 1.5
