"""Independent ground stations steer the emulated rover: it speaks MAVLink, not only our driver."""

import math
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from benches import FRAME, free_udp_port

from drivers.emulators.alone import ANTENNA
from drivers.emulators.field import EmulatedRobot, FieldSpec, start
from drivers.emulators.rover import GUIDED, HOLD, RTL
from drivers.emulators.running import RunningField
from fieldkit.clock import ScaledClock, wall_sleep

RATE = 2.0


@pytest.fixture
def field() -> Iterator[tuple[RunningField, int]]:
    port = free_udp_port()
    robots = (EmulatedRobot("ada", 1, 0.0, 0.0),)
    spec = FieldSpec(
        ScaledClock(RATE), FRAME, ANTENNA, (), robots, f"127.0.0.1:{port}", 1, max_speed_m_s=2.0,
        gcs_failsafe_s=60.0,
    )  # fmt: skip
    with start(spec) as running:
        yield running, port


def rover(field: RunningField) -> dict[str, Any]:
    return dict(field.counts()["robots"]["ada"])


def is_at(field: RunningField, east_m: float, north_m: float) -> bool:
    east, north, _ = field.truth()["ada"]
    return (
        math.hypot(east - east_m, north - north_m) < 1.5
    )  # as large as its speed: it turns wide, and rests beside


def wait_until(condition: Callable[[], object], timeout_s: float = 60.0) -> None:
    for _ in range(int(timeout_s / 0.05)):
        if condition():
            return
        wall_sleep(0.05)
    raise AssertionError(f"did not happen within {timeout_s:g} s")


def test_mavsdk_discovers_arms_steers_holds_and_returns(field: tuple[RunningField, int]) -> None:
    mavsdk = pytest.importorskip(
        "mavsdk", minversion="4", reason="mavsdk 4 is not installed: pip install .[dev]"
    )
    from mavsdk.plugins.action import Action

    running, port = field
    sdk = mavsdk.Mavsdk(mavsdk.Configuration.create_with_component_type(mavsdk.ComponentType.GROUND_STATION))
    try:
        sdk.add_any_connection(f"udpin://127.0.0.1:{port}")
        system = sdk.first_autopilot(30.0)
        assert system is not None
        action = Action(system)
        action.arm()
        assert rover(running)["armed"]
        lat_deg, lon_deg, _ = FRAME.to_geodetic(3.0, 4.0)
        action.goto_location(lat_deg, lon_deg, 0.0, 0.0)
        assert rover(running)["mode"] == GUIDED
        wait_until(lambda: is_at(running, 3.0, 4.0))
        action.hold()
        assert rover(running)["mode"] == HOLD
        action.return_to_launch()
        assert rover(running)["mode"] == RTL
        wait_until(lambda: is_at(running, 0.0, 0.0))
        action.disarm()
        assert not rover(running)["armed"]
    finally:
        sdk.destroy()


def test_mavproxy_discovers_arms_steers_holds_and_returns(
    field: tuple[RunningField, int], tmp_path: Path
) -> None:
    pytest.importorskip("MAVProxy", reason="MAVProxy is not installed: pip install .[dev]")
    program = Path(sys.executable).with_name("mavproxy.py")
    running, port = field
    command = [
        str(program),
        f"--master=udpin:127.0.0.1:{port}",
        "--default-modules=mode,arm,cmdlong",
        "--nowait",
    ]
    proxy = subprocess.Popen(
        [sys.executable, *command], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        cwd=tmp_path, text=True,
    )  # fmt: skip
    assert proxy.stdin is not None

    def tell(line: str, done: Callable[[], object]) -> None:
        """Type a line, again now and then: at first it waits for the vehicle."""
        assert proxy.stdin is not None
        for _ in range(15):
            proxy.stdin.write(line + "\n")
            proxy.stdin.flush()
            for _ in range(40):
                if done():
                    return
                wall_sleep(0.05)
        raise AssertionError(f"{line!r} had no effect")

    try:
        tell("arm throttle", lambda: rover(running)["armed"])
        tell("mode GUIDED", lambda: rover(running)["mode"] == GUIDED)
        lat_deg, lon_deg, _ = FRAME.to_geodetic(3.0, 4.0)
        tell(f"guided {lat_deg:.7f} {lon_deg:.7f} 0", lambda: field[0].truth()["ada"][1] > 0.5)
        wait_until(lambda: is_at(running, 3.0, 4.0))
        tell("mode HOLD", lambda: rover(running)["mode"] == HOLD)
        tell("mode RTL", lambda: rover(running)["mode"] == RTL)
        wait_until(lambda: is_at(running, 0.0, 0.0))
        tell("disarm", lambda: not rover(running)["armed"])
    finally:
        proxy.kill()
        said = proxy.communicate()[0]
        print(said[-3000:])
