"""ArduPilot's own simulators as child processes, set up as docs/hardware.md says. They live outside the project.

`FIELDKIT_SITL` names a folder with `ardurover` and `arducopter`. Everything stays on the loopback.
"""

import asyncio
import os
import shutil
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

FOLDER = os.environ.get("FIELDKIT_SITL", "")
FIRST = os.getpid() % 150
"""The first instance: simulators of two tests at a time must not share their other ports."""
READY_S = 120.0
"""An EKF takes about 40 s from the boot to a usable position."""

CALIBRATED = {
    f"INS_ACC{number}{kind}_{axis}": 1.001 if kind == "SCAL" else 0.001
    for number in ("", "2")
    for kind in ("OFFS", "SCAL")
    for axis in "XYZ"
}
"""A simulated vehicle counts as calibrated with any offset that is not zero."""
COMMON = CALIBRATED | {
    "FS_GCS_TIMEOUT": 5, "MAV_GCS_SYSID": 245, "SYSID_MYGCS": 245, "FS_OPTIONS": 0, "FS_EKF_ACTION": 1,
    "BATT_MONITOR": 4,
    "BATT_LOW_VOLT": 10.5, "FENCE_TYPE": 4, "RC1_MIN": 1000, "RC1_MAX": 2000, "RC3_MIN": 1000, "RC3_MAX": 2000,
    "LOG_DISARMED": 0, "LOG_BACKEND_TYPE": 0,
}  # fmt: skip
"""The station's number has another name from 4.7 on; a vehicle passes over what it does not know."""
ROVER = COMMON | {
    "FS_GCS_ENABLE": 1, "FS_ACTION": 2, "FS_TIMEOUT": 1.5, "FENCE_ACTION": 2, "BATT_FS_LOW_ACT": 2,
    "SERVO1_MIN": 1000, "SERVO1_MAX": 2000, "SERVO3_MIN": 1000, "SERVO3_MAX": 2000, "CRUISE_SPEED": 5,
    "CRUISE_THROTTLE": 30, "ATC_SPEED_P": 0.1, "ATC_STR_RAT_FF": 0.75, "WP_RADIUS": 2, "WP_SPEED": 2,
}  # fmt: skip
COMPASSES = {
    f"COMPASS_OFS{number}_{axis}": offset
    for number in ("", "2", "3")
    for axis, offset in (("X", 5), ("Y", 13), ("Z", -18))
}
COPTER = COMMON | COMPASSES | {
    "FS_GCS_ENABLE": 5, "FENCE_ACTION": 1, "BATT_FS_LOW_ACT": 1, "FRAME_CLASS": 1, "FRAME_TYPE": 0,
    "WPNAV_SPEED": 200, "RTL_ALT": 1000, "ARMING_CHECK": 1, "BATT_CAPACITY": 20000,
}  # fmt: skip
"""With the 3.3 Ah that it has by itself a simulated copter is at a mission's reserve after four minutes."""


@dataclass(frozen=True, slots=True)
class Simulated:
    """One vehicle: `rover` or `copter`, and where it stands."""

    kind: str
    system_id: int
    lat_deg: float
    lon_deg: float
    heading_deg: float = 0.0


def binary(kind: str) -> str:
    """The simulator's program; skips the test, with the reason, where there is none."""
    if not FOLDER:
        pytest.skip("no simulators: set FIELDKIT_SITL to a folder with ardurover and arducopter")
    path = shutil.which(str(Path(FOLDER) / f"ardu{kind}"))
    if path is None:
        pytest.skip(f"FIELDKIT_SITL: there is no ardu{kind} in {FOLDER}")
    return path


@asynccontextmanager
async def simulators(
    vehicles: Sequence[Simulated], folder: Path, port: int, **changed: float
) -> AsyncIterator[list["asyncio.subprocess.Process"]]:
    """Run them; each sends to a UDP port of this computer. `changed` parameters are set before they boot."""
    programs = [binary(vehicle.kind) for vehicle in vehicles]
    running = []
    try:
        for number, (program, vehicle) in enumerate(zip(programs, vehicles, strict=True)):
            place = folder / f"{vehicle.kind}{vehicle.system_id}"
            place.mkdir()
            values = (COPTER if vehicle.kind == "copter" else ROVER) | changed
            (place / "vehicle.parm").write_text(
                "".join(f"{name} {value}\n" for name, value in values.items())
            )
            home = f"{vehicle.lat_deg:.8f},{vehicle.lon_deg:.8f},400,{vehicle.heading_deg:g}"
            running.append(
                await asyncio.create_subprocess_exec(
                    program, "--model", "+" if vehicle.kind == "copter" else "rover", "--home", home,
                    "--speedup", "1", "--wipe", "--defaults", "vehicle.parm", "-I", str(FIRST + number),
                    "--sysid", str(vehicle.system_id), "--serial0", f"udpclient:127.0.0.1:{port}",
                    cwd=place, stdin=asyncio.subprocess.DEVNULL, stdout=(place / "out.txt").open("w"),
                    stderr=asyncio.subprocess.STDOUT,
                )
            )  # fmt: skip
        yield running
    finally:
        for process in running:
            if process.returncode is None:
                process.kill()
            await process.wait()
