"""The same orders to three firmwares, each with its own quirks."""

from collections.abc import Awaitable, Callable

import numpy as np
import pytest
from benches import FRAME, around, free_udp_port, rovers_on_udp
from scenarios import SCENARIOS, Drive, driving

from drivers.emulators.fence import edge_ahead_m
from drivers.emulators.profiles import COPTER, PROFILES, ROVER, Profile
from drivers.emulators.rover import make_autopilot
from drivers.mavlink.codec import Packer, Parser, mavlink
from drivers.mavlink.fleet import open_link
from drivers.mavlink.plans import polygon_fence
from fieldkit.clock import ScaledClock
from fieldkit.world.bodies import Car, Copter

Scenario = Callable[[Drive], Awaitable[None]]
SQUARE_M = [(-20.0, -20.0), (20.0, -20.0), (20.0, 20.0), (-20.0, 20.0)]


@pytest.mark.parametrize("scenario", SCENARIOS.values(), ids=SCENARIOS)
@pytest.mark.parametrize("profile", PROFILES.values(), ids=PROFILES)
async def test_the_emulated_vehicle_does_what_a_real_one_does(profile: Profile, scenario: Scenario) -> None:
    """`tests/system/test_sitl_vehicles.py` runs the same on ArduPilot's simulators, where there are some."""
    clock, port = ScaledClock(10.0), free_udp_port()
    async with rovers_on_udp({1: (0.0, 0.0)}, clock, port, profile, gcs_failsafe_s=15.0) as vehicles:
        autopilot = vehicles[0].autopilot
        autopilot.body.max_speed_m_s = 2.0
        own = {"WP_SPEED": 2.0, "WPNAV_SPEED": 200.0}
        autopilot.parameters |= {name: own[name] for name in own if name in autopilot.parameters}
        link = open_link(f"udpin:127.0.0.1:{port}", {"ada": {"system_id": 1}}, around(clock))
        async with driving(link, clock, 20.0) as drive:
            await scenario(drive)


# Quirks measured on the simulators


class Bench:
    """One autopilot without a wire."""

    def __init__(self, profile: Profile) -> None:
        body = Copter(0.0, 0.0, up_m=5.0) if profile is COPTER else Car(0.0, 0.0, max_speed_m_s=2.0)
        self.rover = make_autopilot(profile, 1, body, FRAME, np.random.default_rng(1))
        self.packer, self.parser, self.t_s = Packer(245, 190), Parser(), 0.0
        self.tell(mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0))
        self.rover._change_mode(profile.guided)

    def tell(self, message: object) -> list[object]:
        return list(self.parser.parse(self.rover.receive(self.packer.pack(message), self.t_s)))

    def run(self, duration_s: float) -> list[object]:
        heard: list[object] = []
        for _ in range(int(duration_s * 10)):
            self.t_s += 0.1
            heard += self.parser.parse(self.rover.update(self.t_s))
        return heard

    def fence(self) -> None:
        corners = [FRAME.to_geodetic(east, north)[:2] for east, north in SQUARE_M]
        items = polygon_fence([(round(a * 1e7), round(o * 1e7)) for a, o in corners])
        self.rover.plans.items[1] = [
            mavlink.MAVLink_mission_item_int_message(
                1, 1, n, 0, item.command, 0, 1, *item.params, item.lat_e7, item.lon_e7, 0, 1
            )
            for n, item in enumerate(items)
        ]
        self.rover.parameters["FENCE_ENABLE"] = 1.0

    def reposition(self, east_m: float, north_m: float) -> int:
        lat, lon, _ = FRAME.to_geodetic(east_m, north_m)
        message = mavlink.MAVLink_command_int_message(
            1, 1, 6, 192, 0, 0, -1.0, 1, 0, float("nan"), round(lat * 1e7), round(lon * 1e7), 5.0
        )
        return next(m.result for m in self.tell(message) if m.get_type() == "COMMAND_ACK")  # type: ignore[attr-defined]


def test_a_rover_stops_before_its_own_fence_and_says_nothing() -> None:
    bench = Bench(ROVER)
    bench.fence()
    assert bench.reposition(0.0, 40.0) == 0, "accepted: a rover takes targets outside its fence"
    said = bench.run(60.0)
    assert 16.0 < bench.rover.body.north_m < 18.0
    assert bench.rover.mode == ROVER.guided
    assert not [m for m in said if m.get_type() == "STATUSTEXT"]  # type: ignore[attr-defined]
    bench.reposition(0.0, 0.0)
    bench.run(30.0)
    assert bench.rover.body.north_m < 1.0, "away from the fence it drives"


def test_a_copter_fails_a_target_outside_its_fence() -> None:
    bench = Bench(COPTER)
    bench.fence()
    assert bench.reposition(0.0, 40.0) == 4
    assert bench.reposition(0.0, 10.0) == 0


def test_a_copter_drops_a_position_target_without_height() -> None:
    lat, lon, _ = FRAME.to_geodetic(0.0, 10.0)
    for profile, mask, moves in ((COPTER, 0x0DFC, False), (COPTER, 0x0DF8, True), (ROVER, 0x0DFC, True)):
        bench = Bench(profile)
        numbers = [5.0, *[0.0] * 8]
        bench.tell(
            mavlink.MAVLink_set_position_target_global_int_message(
                0, 1, 1, 6, mask, round(lat * 1e7), round(lon * 1e7), *numbers
            )
        )
        bench.run(5.0)
        assert (bench.rover.body.north_m > 1.0) == moves


def test_mode_four_holds_a_rover_and_sets_a_copter_free() -> None:
    """Why nothing is ever broadcast: one DO_SET_MODE 4 means opposite things."""
    for profile, mode in ((ROVER, ROVER.hold), (COPTER, COPTER.guided)):
        bench = Bench(profile)
        bench.tell(mavlink.MAVLink_command_long_message(0, 1, 176, 0, 1, 4, 0, 0, 0, 0, 0))
        assert bench.rover.mode == mode == 4


def test_the_edge_ahead_is_where_the_way_leaves_the_fence() -> None:
    assert edge_ahead_m((0.0, 0.0), (0.0, 5.0), SQUARE_M) == pytest.approx(20.0)
    assert edge_ahead_m((5.0, 0.0), (9.0, 0.0), SQUARE_M) == pytest.approx(15.0)
    assert edge_ahead_m((5.0, 0.0), (5.0, 0.0), SQUARE_M) == pytest.approx(15.0)
    assert edge_ahead_m((30.0, 0.0), (0.0, 0.0), SQUARE_M) == pytest.approx(-10.0)
