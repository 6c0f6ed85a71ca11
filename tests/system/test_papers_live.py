"""Systems of the papers on emulated radios and rovers, through the real drivers; recordings replay bit for bit."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sizes import size

from fieldkit.channel.antenna_file import AntennaFile
from fieldkit.channel.pattern import lobe_gain_db
from fieldkit.messages import GoTo
from fieldkit.recording.reader import open_recording
from mission.lab.synthetic import ANTENNA, hidden_sources, small_mission
from mission.replay.replay import replay
from mission.shell import setups
from mission.shell.flight import fly
from mission.shell.warm_up import warm_up

HEADING = np.arange(0.0, 360.0, 10.0)
FAR = replace(ANTENNA, threshold_dbm=-95.0)
LOBE = AntennaFile(
    FAR,
    model="tabulated",
    pattern={"heading_deg": HEADING.tolist(), "gain_db": lobe_gain_db(HEADING, 0.0, 4.0, -15.0).tolist()},
)
PAIRWISE = {"belief": "spog", "sensing": "pairwise", "prior_rule": "dirichlet"}
SYSTEMS = {
    "prwa": ({**PAIRWISE, "planner": "prwa"}, 4, AntennaFile(FAR)),
    "rwa": ({"belief": "spog", "sensing": "directional", "planner": "rwa"}, 1, LOBE),
    "dprwa": ({**PAIRWISE, "planner": "dprwa"}, 4, AntennaFile(FAR)),
    "csma-pf": ({"belief": "csma-pf", "planner": "probable", "sensing": "directional"}, 1, LOBE),
}


@pytest.mark.parametrize("name", size(["prwa", "rwa"], list(SYSTEMS)))
def test_a_system_of_the_papers_flies_the_live_path(name: str, tmp_path: Path) -> None:
    engine, robots, antenna = SYSTEMS[name]
    mission = small_mission(
        tmp_path, seed=2, duration_s=40.0, robots=robots, sources_found=9, engine=engine, antenna=antenna
    )
    warm_up(mission)
    log = tmp_path / "mission.mcap"
    with setups.emulated(mission, hidden_sources(2), seed=2, rate=5.0) as setup:
        runner = fly(mission, setup, log, truth=hidden_sources(2))
    assert "time is up" in runner.end_reason
    assert runner.kernel.detections > 0
    steered = {c.robot for _, _, _, c in open_recording(log).commands() if isinstance(c, GoTo)}
    assert len(steered) == robots
    done = replay(log)
    assert done.complete
    assert done.kernel.digest() == runner.kernel.digest()
    assert done.kernel.commands_digest() == runner.kernel.commands_digest()
