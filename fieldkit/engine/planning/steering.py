"""From the corners a team is to pass to way-points for each of its robots, round ground they must not enter."""

import numpy as np

from fieldkit.engine.planning.base import abreast, waypoints
from fieldkit.engine.planning.detour import Detours
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import FloatArray, Waypoint


class Steering:
    """The way-points of one mission's teams."""

    def __init__(self, settings: EngineSettings) -> None:
        self.settings = settings
        self.detours = Detours(
            settings.grid, settings.keep_out, settings.fence_margin_m, settings.tuning.ridges.clearance_m
        )

    def steer(
        self, team: tuple[str, ...], start_m: FloatArray, corners_m: FloatArray, spacing_m: float
    ) -> dict[str, tuple[Waypoint, ...]]:
        """Way-points for a team that follows corners (k, 2) abreast from `start_m` (m, 2).

        No leg touches what must be kept out of: robots go round it, and leave out what cannot be reached. A robot
        that cannot go anywhere has an empty path.
        """
        settings = self.settings
        spacing = max(spacing_m, settings.min_separation_m)
        places = abreast(corners_m, start_m, spacing, settings.grid, settings.fence_margin_m)
        places = self.detours.ways(places, start_m)
        moves = (places != start_m).any(axis=(0, 2))
        paths = waypoints(places, start_m, settings.max_speed_m_s)
        if not settings.keep_out.needs_detours:
            return dict(zip(team, paths, strict=True))
        return {robot: path if goes else () for robot, path, goes in zip(team, paths, moves, strict=True)}

    def allowed(self, place_m: FloatArray) -> FloatArray:
        """(2,) the place itself, or the nearest to it that robots may be at."""
        return self.detours.nearest(place_m) if self.settings.keep_out.contains(place_m[None])[0] else place_m

    def within(self, here_m: FloatArray, goal_m: FloatArray, most_m: float) -> FloatArray:
        """(k, 2) corners of the way from `here_m` to `goal_m`, cut off after `most_m`; none without a way."""
        way = self.detours.way(here_m, goal_m)
        corners, left = [], most_m
        for corner in way if way is not None else ():
            length = float(np.hypot(*(corner - here_m)))
            corners.append(here_m + (corner - here_m) * min(1.0, left / max(length, 1e-9)))
            left -= length
            if left <= 0.0:
                break
            here_m = corner
        return np.array(corners).reshape(-1, 2)
