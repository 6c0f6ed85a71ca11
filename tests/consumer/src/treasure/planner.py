"""A planner that sends every robot to the most probable cell, each to a side of its own."""

import math

import numpy as np

import fieldkit
from fieldkit.messages import Plan, Waypoint


class ToThePeak(fieldkit.Planner):
    """See the module."""

    def __init__(self, settings: fieldkit.EngineSettings) -> None:
        self.settings = settings
        self._plans = 0

    def plan(self, situation: fieldkit.Situation, belief: fieldkit.Belief) -> Plan:
        grid, margin_m = self.settings.grid, self.settings.fence_margin_m
        presence = belief.presence()
        row, column = np.unravel_index(int(np.argmax(presence)), presence.shape)
        self._plans += 1
        robots = [robot for team in situation.teams for robot in team]
        paths: dict[str, tuple[Waypoint, ...]] = {}
        for index, robot in enumerate(robots):
            bearing = 2.0 * math.pi * index / len(robots) + 0.7 * self._plans
            far_m = 2.0 * self.settings.min_separation_m
            east_m = float(grid.east_m[column]) + far_m * math.sin(bearing)
            north_m = float(grid.north_m[row]) + far_m * math.cos(bearing)
            paths[robot] = (
                Waypoint(
                    min(max(east_m, margin_m), grid.size_east_m - margin_m),
                    min(max(north_m, margin_m), grid.size_north_m - margin_m),
                    self.settings.max_speed_m_s,
                ),
            )
        return Plan(situation.t_ns, paths, dict.fromkeys(robots, "peak"))
