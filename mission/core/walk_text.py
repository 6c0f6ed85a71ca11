"""The mission file of a walk, for people who have not written one: a square field round where they stand."""

from dataclasses import dataclass
from typing import Any

import tomlkit

from fieldkit import settings as given

CELLS_A_SIDE = 60
"""Of the field: the belief refines itself where it needs to."""
POSITION_SIGMA_M = 3.0
KEPT_MB = 48
"""Of a belief that runs beside other things on what a person carries."""


@dataclass(frozen=True, slots=True)
class WalkOptions:
    """What a walk needs to know."""

    receiver: dict[str, Any]
    """Driver and its options."""
    gnss: str
    """Port of the satellite receiver."""
    antenna: str
    """Path of the antenna file, as the mission file will find it."""
    origin_deg: tuple[float, float]
    """Of the field's south-west corner."""
    size_m: float = given.WALK_SIDE_M
    rate_hz: float = given.WALK_RATE_HZ
    expected: float = 1.0
    found_within_m: float = given.WALK_FOUND_WITHIN_M
    name: str = "walk"
    person: str = given.WALKER
    seed: int = 0
    max_duration_s: float = 4 * 3600.0
    rate: float = 1.0
    """Of the mission's clock: limits of the steering loop are of wall time."""
    cot: tuple[str, ...] = ()
    """Addresses that get Cursor on Target."""
    background: str = ""
    """A map under the page's, as the mission file will find it."""


def walk_text(options: WalkOptions) -> str:
    """A mission file in TOML."""
    o = options
    lat_deg, lon_deg = o.origin_deg
    cell_m = max(0.5, round(o.size_m / CELLS_A_SIDE, 1))
    return tomlkit.dumps(
        {
            "schema": 1,
            "name": o.name,
            "seed": o.seed,
            "field": {
                "origin_lat_deg": round(lat_deg, 7),
                "origin_lon_deg": round(lon_deg, 7),
                "size_east_m": o.size_m,
                "size_north_m": o.size_m,
                "cell_m": cell_m,
                **({"background": o.background} if o.background else {}),
            },
            "antenna": {"file": o.antenna},
            "sources": {"rate_hz": o.rate_hz, "expected": o.expected},
            "engine": {
                "found_within_m": o.found_within_m,
                "pose_sigma_m": POSITION_SIGMA_M,
                "planning_period_s": 30.0,
            },
            "tuning": {"intensity": {"kept_mb": KEPT_MB}},
            # Satellite receivers give a position a second, and now and then miss one.
            "association": {"window_s": 0.5, "lateness_s": 2.0, "max_pose_gap_s": 5.0},
            "end": {"max_duration_s": o.max_duration_s, "sources_found": max(1, round(o.expected))},
            "safety": {
                "fence_margin_m": 0.0,
                "max_speed_m_s": 1.5,
                "pose_timeout_s": min(60.0, max(10.0, 5.0 * o.rate)),
                "overrun_s": min(60.0, max(5.0, 3.0 * o.rate)),
                "stall_s": 600.0,
                "min_separation_m": 0.5,
            },
            **({"maps": {"cot": list(o.cot)}} if o.cot else {}),
            "team": [{"robots": [o.person]}],
            "positions": [{"driver": "gnss", "robots": {o.person: o.gnss}}],
            "robot": [
                {
                    "name": o.person,
                    "receiver": o.receiver,
                    "vehicle": {"driver": "person", "address": "page"},
                }
            ],
        }
    )
