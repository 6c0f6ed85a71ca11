"""`fieldkit treasure mission.toml`: fly a mission over one source in virtual time, and say how it went."""

import json
from pathlib import Path

import fieldkit


def treasure(mission: Path, recording: Path, east_m: float, north_m: float, seed: int = 1) -> None:
    """Hide a transmitter at EAST_M NORTH_M and look for it with the mission's belief and planner."""
    result = fieldkit.simulate(
        fieldkit.read_mission(mission), [(east_m, north_m)], seed=seed, recording=recording
    )
    log = fieldkit.open_log(recording)
    found = [(source.east_m, source.north_m) for source in result.found]
    figure = fieldkit.plot_field(log)
    figure.savefig(recording.with_suffix(".png"))
    print(
        json.dumps(
            {
                "belief": type(result.belief).__name__,
                "end_reason": result.end_reason,
                "found": found,
                "readings": len(log.readings),
            }
        )
    )
