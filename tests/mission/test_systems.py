"""Every system of the papers as a mission.toml: flown in simulation, recorded, and replayed bit for bit."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from sizes import size

from fieldkit import plugins
from fieldkit.channel.antenna_file import AntennaFile
from fieldkit.channel.pattern import dipole_gain_db, lobe_gain_db
from fieldkit.errors import ConfigError
from fieldkit.messages import GoTo
from fieldkit.recording.reader import open_recording
from mission.lab.synthetic import ANTENNA, record_simulated, small_mission
from mission.replay.replay import replay

FAR = replace(ANTENNA, threshold_dbm=-95.0)
"""Hears the whole field, as single robots do in the papers."""
HEADING = np.arange(0.0, 360.0, 10.0)


def directional(model: str, gain_db: np.ndarray) -> AntennaFile:
    table = {"heading_deg": HEADING.tolist(), "gain_db": np.round(gain_db, 3).tolist()}
    return AntennaFile(FAR, model=model, pattern=table)


LOBE = directional("tabulated", lobe_gain_db(HEADING, 0.0, 4.0, -15.0))
DIPOLE = directional("tabulated", dipole_gain_db(HEADING, 0.0, 6.0, -15.0))
PLAIN = AntennaFile(ANTENNA)


@dataclass(frozen=True)
class System:
    name: str
    engine: dict[str, str | float | bool]
    robots: int = 4
    antenna: AntennaFile = field(default=PLAIN)


PAIRWISE: dict[str, str | float | bool] = {
    "belief": "spog",
    "sensing": "pairwise",
    "prior_rule": "dirichlet",
}
SINGLE: dict[str, str | float | bool] = {"belief": "spog", "sensing": "directional"}
BASELINES = ("pair-random-walk", "random-walk", "pair-patrol", "patrol")
SYSTEMS = [
    System("prwa", {**PAIRWISE, "planner": "prwa"}),
    System("prwa as printed", {**PAIRWISE, "planner": "prwa", "prior_rule": "literal"}),
    System("prwa, normalised", {**PAIRWISE, "planner": "prwa", "normalised_entropy": True}),
    System("prwa, an odd robot", {**PAIRWISE, "planner": "prwa"}, robots=3),
    System("rwa", {**SINGLE, "planner": "rwa"}, 1, LOBE),
    *(
        System(f"{name} {form}", {**SINGLE, "planner": "rwa", "directional_form": form}, 1, antenna)
        for name, form, antenna in (
            ("rwa", "interval", LOBE),
            ("rwa", "density", LOBE),
            ("rwa-2009", "truncated", DIPOLE),
        )
    ),
    System("rwa, three robots", {"belief": "spog", "planner": "rwa", "prior_rule": "em"}, 3),
    System("dprwa", {**PAIRWISE, "planner": "dprwa"}),
    System("dprwa-apart", {**PAIRWISE, "planner": "dprwa-apart"}),
    System("dprwa in groups", {**PAIRWISE, "planner": "dprwa", "group_gap_m": 3.0}),
    System("dprwa, an odd robot", {**PAIRWISE, "planner": "dprwa"}, robots=3),
    System("csma-pf", {"belief": "csma-pf", "planner": "probable"}, 1, AntennaFile(FAR)),
    System(
        "csma-pf, directional",
        {"belief": "csma-pf", "planner": "probable", "sensing": "directional"},
        1,
        DIPOLE,
    ),
    *(System(name, {**PAIRWISE, "planner": name}) for name in BASELINES),
    *(
        System(f"{name}, one robot", {"belief": "spog", "planner": name}, 1)
        for name in (*BASELINES, "prwa", "dprwa")
    ),
]


def test_no_planner_and_no_belief_is_left_out() -> None:
    of_today = {"infogain", "infogain1"}
    assert {s.engine["planner"] for s in SYSTEMS} == set(plugins.names("fieldkit.planners")) - of_today
    assert {s.engine["belief"] for s in SYSTEMS} == set(plugins.names("fieldkit.beliefs")) - {"intensity"}


@pytest.mark.parametrize("system", SYSTEMS, ids=lambda system: system.name)
def test_it_flies_hears_and_replays_bit_for_bit(system: System, tmp_path: Path) -> None:
    log = record_simulated(
        tmp_path,
        seed=2,
        duration_s=size(60.0, 150.0),
        robots=system.robots,
        sources_found=9,
        engine=system.engine,
        antenna=system.antenna,
    )
    recording = open_recording(log)
    result = recording.result()
    assert result is not None and result["detections"] > 0
    steered = {command.robot for _, _, _, command in recording.commands() if isinstance(command, GoTo)}
    assert len(steered) == system.robots
    done = replay(log)
    assert done.complete
    assert done.kernel.digest() == result["belief_hash"]
    assert done.kernel.commands_digest() == result["commands_hash"]


def test_pairwise_sensing_with_one_robot_is_refused_before_anything_moves(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="at least two robots heard, got 1"):
        record_simulated(tmp_path, robots=1, engine={**PAIRWISE, "planner": "prwa"})


def test_a_directional_mission_wants_an_antenna_with_a_pattern_and_the_reverse(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="directional"):
        small_mission(tmp_path, engine={"belief": "spog", "sensing": "directional"})
    with pytest.raises(ConfigError, match="directional"):
        small_mission(tmp_path, engine={"belief": "spog", "planner": "prwa"}, antenna=LOBE)
    assert small_mission(
        tmp_path, antenna=LOBE
    ).kernel.engine.antenna.pattern_db  # the default belief knows headings
