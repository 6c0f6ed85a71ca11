"""`import fieldkit`: what is public, that it is light, and that it does what it says."""

import inspect
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import fieldkit
from fieldkit.errors import CalibrationRefused, ConfigError
from mission.lab.synthetic import small_mission

HEAVY = ("numpy", "scipy", "numba", "matplotlib", "pydantic", "mission", "drivers", "calibration")
READINGS = Path(__file__).parents[2] / "examples" / "readings.csv"


def test_importing_fieldkit_imports_nothing_heavy_and_none_of_its_siblings() -> None:
    code = f"import sys, fieldkit; print([m for m in {HEAVY!r} if m in sys.modules])"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stdout.strip() == "[]"


def test_help_is_shown_without_anything_heavy() -> None:
    heavy = tuple(name for name in HEAVY if name not in ("mission", "drivers", "calibration"))
    code = (
        "import sys\nsys.argv = ['fieldkit', '--help']\nfrom fieldkit.cli import main\n"
        f"try:\n    main()\nfinally:\n    print([m for m in {heavy!r} if m in sys.modules], file=sys.stderr)"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "calibrate" in said.stdout and said.stderr.strip() == "[]"


def test_every_public_name_is_there_documented_and_listed() -> None:
    assert sorted(fieldkit.__all__) == dir(fieldkit)
    for name in fieldkit.__all__:
        value = getattr(fieldkit, name)
        assert name == "__version__" or inspect.getdoc(value), name


def test_a_name_that_is_not_public_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = fieldkit.nonsense  # type: ignore[attr-defined]


def test_public_functions_document_their_errors() -> None:
    for name in fieldkit.__all__:
        value = getattr(fieldkit, name)
        takes_something = inspect.isfunction(value) and inspect.signature(value).parameters
        if takes_something and not name.startswith("plot_calibration"):
            assert "Raises" in (inspect.getdoc(value) or "") or "errors" in (inspect.getdoc(value) or ""), (
                name
            )


def test_beliefs_and_planners_by_name() -> None:
    settings = fieldkit.EngineSettings(
        fieldkit.Grid(10.0, 10.0, 0.5), fieldkit.Antenna(2.5, -62.0, 3.0, -70.0), (("r1", "r2"),)
    )
    assert {"intensity", "spog"} <= set(fieldkit.belief_names())
    assert {"infogain", "prwa"} <= set(fieldkit.planner_names())
    belief = fieldkit.make_belief("intensity", settings)
    plan = fieldkit.make_planner("infogain", settings).plan(
        fieldkit.Situation(0, {"r1": (1.0, 1.0), "r2": (2.0, 1.0)}, (("r1", "r2"),), {}), belief
    )
    assert belief.presence().shape == settings.grid.shape
    assert plan.paths["r1"]
    with pytest.raises(ConfigError, match="known names are"):
        fieldkit.make_belief("crystal-ball", settings)


def test_a_planner_says_what_a_belief_lacks() -> None:
    settings = fieldkit.EngineSettings(
        fieldkit.Grid(10.0, 10.0, 0.5), fieldkit.Antenna(2.5, -62.0, 3.0, -70.0), (("r1", "r2"),)
    )
    planner = fieldkit.make_planner("infogain", settings)
    there = fieldkit.Situation(0, {"r1": (1.0, 1.0), "r2": (2.0, 1.0)}, (("r1", "r2"),), {})
    with pytest.raises(ConfigError, match="SpogBelief lacks exposure_s, ground_value, model, unresolved"):
        planner.plan(there, fieldkit.make_belief("spog", settings))


def test_readings_become_an_antenna_file_and_a_curve(tmp_path: Path) -> None:
    calibration = fieldkit.calibrate(READINGS)
    assert calibration.verdict != "refused"
    again = fieldkit.read_antenna(calibration.save(tmp_path / "antenna.toml"))
    assert again.antenna == calibration.antenna_file.antenna
    assert isinstance(fieldkit.plot_calibration(calibration), Figure)


def test_a_refused_calibration_is_not_saved(tmp_path: Path) -> None:
    few = tmp_path / "few.csv"
    few.write_text("\n".join(READINGS.read_text().splitlines()[:80]) + "\n")
    calibration = fieldkit.calibrate(few)
    assert calibration.verdict == "refused" and calibration.reasons
    with pytest.raises(CalibrationRefused):
        calibration.save(tmp_path / "antenna.toml")
    assert not (tmp_path / "antenna.toml").exists()


def test_a_mission_is_simulated_recorded_opened_and_drawn(tmp_path: Path) -> None:
    small_mission(tmp_path, duration_s=60.0, sources_found=9)
    mission = fieldkit.read_mission(str(tmp_path / "mission.toml"))
    there = [(3.0, 4.0), fieldkit.TransientSource(7.5, 6.0, -2.0, 0.2)]
    first = fieldkit.simulate(mission, there, seed=5, recording=tmp_path / "run.mcap")
    again = fieldkit.simulate(mission, there, seed=5)
    assert first.belief.digest() == again.belief.digest()
    assert first.sources[1] == there[1]
    log = fieldkit.open_log(tmp_path / "run.mcap")
    assert set(np.unique(log.poses["robot"])) == {"r1", "r2", "r3", "r4"}
    field, history = fieldkit.plot_field(log), fieldkit.plot_history(tmp_path / "run.mcap")
    assert len(field.axes) == 2 and len(history.axes) == 2


def test_a_source_outside_the_field_is_refused(tmp_path: Path) -> None:
    mission = small_mission(tmp_path)
    with pytest.raises(ConfigError, match="expected places in the field of 10 m x 10 m"):
        fieldkit.simulate(mission, [(30.0, 4.0)])
