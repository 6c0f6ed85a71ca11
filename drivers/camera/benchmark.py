"""How well and how fast the camera finds robots on rendered films: `fieldkit bench camera`.

Four robots on 10 x 10 m seen from 9.5 m up, 1280 x 720, 16 Hz, Motion JPEG, in noise, blur, shadow and with a thing
in the way; the calibration's clicks are half a pixel off. Needs the extra `[camera]`.
"""

import asyncio
import math
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from drivers.camera.capture import Finder, open_video
from drivers.camera.source import CameraOptions, make_task, open_camera
from drivers.emulators.camera import Scene, Shown, circle, still, write_calibration, write_film
from fieldkit.clock import RealClock
from fieldkit.geo import FieldFrame
from fieldkit.ports import DriverContext

ROBOT_UP_M = 0.3


def camera(duration_s: float = 12.0) -> dict[str, Any]:
    """Errors, share of robots found, time and core share, for markers and for colour patches."""
    with tempfile.TemporaryDirectory() as folder:
        return {
            "picture": "1280x720, 16 Hz, Motion JPEG, rendered",
            "markers": _measure(marker_scene(), Path(folder), duration_s),
            "patches": _measure(patch_scene(), Path(folder), duration_s),
        }


def marker_scene() -> Scene:
    """Four robots with 0.4 m markers, 0.3 m up; one is driven under something now and then."""
    robots = {
        "ada": Shown(circle(3.0, 3.0, 2.0), marker=3, height_m=ROBOT_UP_M),
        "bob": Shown(circle(7.0, 7.0, 2.5), marker=7, height_m=ROBOT_UP_M),
        "cyd": Shown(still(9.5, 9.5, 200.0), marker=9, height_m=ROBOT_UP_M),
        "dan": Shown(still(0.6, 0.5, 77.0), marker=11, height_m=ROBOT_UP_M),
    }
    return Scene(robots, hiding_m=lambda t_s: (3.0 + 0.5 * t_s, 5.0, 0.0))


def patch_scene() -> Scene:
    """Two robots that drive, with a red and a blue, and a green and a magenta patch 0.3 m apart."""
    robots = {
        "ada": Shown(circle(3.0, 3.0, 2.0), mark_m=0.3),
        "bob": Shown(circle(7.0, 7.0, 2.5), mark_m=0.3, front_bgr=(40, 200, 40), rear_bgr=(200, 30, 200)),
    }
    return Scene(robots, hiding_m=lambda t_s: (3.0 + 0.5 * t_s, 5.0, 0.0))


PATCHES = {"ada": ("red", "blue"), "bob": ("green", "magenta")}


def options_for(scene: Scene, source: str, calibration: Path, **more: Any) -> dict[str, Any]:
    """A camera's options for a scene."""
    robots: dict[str, Any] = {}
    for name, shown in scene.robots.items():
        mark: dict[str, Any] = {"mark_m": shown.mark_m, "height_m": shown.height_m}
        if shown.marker is not None:
            robots[name] = mark | {"marker": shown.marker}
        else:
            robots[name] = mark | {"front": PATCHES[name][0], "rear": PATCHES[name][1]}
    return {"source": source, "calibration": str(calibration), "robots": robots, **more}


def _measure(scene: Scene, folder: Path, duration_s: float) -> dict[str, Any]:
    film, calibration = folder / "film.avi", folder / "camera.toml"
    times = write_film(scene, film, duration_s)
    write_calibration(scene, calibration)
    options = options_for(scene, str(film), calibration)
    position_m, heading_deg, found, core_s = errors(scene, options, times)
    late_ms = asyncio.run(_lateness_ms(options))
    return {
        "pictures": len(times),
        "found_share": round(found / (len(times) * len(scene.robots)), 4),
        "position_error_m": _spread(position_m, 4),
        "heading_error_deg": _spread(heading_deg, 2),
        "picture_to_pose_ms": _spread(late_ms, 1),
        "core_share_at_16_hz": round(core_s / len(times) * 16.0, 3),
    }


def errors(
    scene: Scene, options: dict[str, Any], times: list[float]
) -> tuple[list[float], list[float], int, float]:
    """Position (m) and heading (deg) errors against the scene, how many fixes, and the core seconds they took."""
    finder = Finder(make_task(CameraOptions(**options)))
    video = open_video(options["source"])
    position_m, heading_deg, core_s = [], [], 0.0
    for t_s in times:
        began_s = time.process_time()
        good, picture = video.read()
        fixes = finder.fixes(picture, t_s) if good else []
        core_s += time.process_time() - began_s
        for fix in fixes:
            east, north, heading = scene.robots[fix.robot].path(t_s)
            position_m.append(math.hypot(fix.east_m - east, fix.north_m - north))
            heading_deg.append(abs((fix.heading_deg - heading + 180.0) % 360.0 - 180.0))
    video.release()
    return position_m, heading_deg, len(position_m), core_s


async def _lateness_ms(options: dict[str, Any]) -> list[float]:
    """From the picture to its pose in this process, the film at its own pace."""
    clock = RealClock()
    late_ms = []
    async with open_camera(options, DriverContext(clock, FieldFrame(0.0, 0.0))) as source:
        async for pose in source.poses():
            late_ms.append((clock.now_ns() - pose.t_ns) * 1e-6)
    return late_ms[len(late_ms) // 10 :]


def _spread(values: list[float], digits: int) -> dict[str, float]:
    if not values:
        return {}
    cuts = np.percentile(values, [50, 95, 99, 100])
    return {
        name: round(float(cut), digits) for name, cut in zip(("p50", "p95", "p99", "max"), cuts, strict=True)
    }
