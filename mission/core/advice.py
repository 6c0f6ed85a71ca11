"""What a mission file allows but a field team will regret. Notes, not errors."""

import numpy as np

from fieldkit import settings as given
from mission.core.mission_file import Mission

SATELLITE_GAP_S = 1.5
"""Most satellite receivers report their position once a second, now and then a little late."""


def advise(mission: Mission) -> list[str]:
    """Plain sentences, most important first; empty when there is nothing to say."""
    engine = mission.kernel.engine
    ranges = engine.antenna.nominal_range_m(np.array(engine.power_levels_db))
    shortest, longest = float(ranges.min()), float(ranges.max())
    notes = []
    if mission.antenna.verdict != "accepted":
        notes.append(f"the calibration was {mission.antenna.verdict}: {'; '.join(mission.antenna.reasons)}")
    if engine.grid.cell_m > 0.5 * shortest:
        notes.append(
            f"cells of {engine.grid.cell_m} m are coarse for the shortest range of {shortest:.2f} m; "
            f"try {shortest / 5:.2f} m"
        )
    if longest > 0.7 * min(engine.grid.size_east_m, engine.grid.size_north_m):
        notes.append(
            f"the longest range ({longest:.1f} m) spans most of the field: every robot hears everything"
        )
    if mission.kernel.sources_expected is None and mission.kernel.stop_probability_left is None:
        notes.append(f"nothing but the time limit ({mission.kernel.max_duration_s:.0f} s) ends this mission")
    lone = [team[0] for team in engine.teams if len(team) == 1]
    if lone and (engine.keep_teams or mission.kernel.planner != given.PLANNER):
        notes.append(
            f"{', '.join(lone)} moves alone: a pair learns more of an unknown power than two single robots"
        )
    by_satellite = [table for table in mission.file.positions if table.driver == "gnss"]
    if by_satellite and mission.kernel.max_pose_gap_s < SATELLITE_GAP_S:
        notes.append(
            f"association.max_pose_gap_s of {mission.kernel.max_pose_gap_s:g} s bridges no gap between positions of "
            "a satellite receiver, which come once a second: what is not heard would count for little; set it to 5"
        )
    placed = {robot for table in by_satellite for robot in (table.model_extra or {}).get("robots", {})}
    aloft = sorted(placed.intersection(mission.safety.altitude_m))
    if aloft and mission.file.field.origin_alt_m == 0.0:
        notes.append(
            f"{', '.join(aloft)} flies by a satellite receiver, which gives heights above the sea, and "
            "field.origin_alt_m is 0: set it to the field's own, or its height above the ground is wrong"
        )
    if mission.kernel.association_window_s * engine.reference_rate_hz * engine.expected_sources > 0.1:
        notes.append(
            f"association.window_s of {mission.kernel.association_window_s} s will join one transmission in ten "
            "with another source's; synchronise the clocks and shorten it"
        )
    return notes
