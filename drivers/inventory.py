"""What is plugged in and what it can and cannot hear; which vehicles are heard on a link."""

import asyncio
from dataclasses import asdict, dataclass, field
from typing import Any

from serial.tools import list_ports

from drivers.mavlink.codec import AUTOPILOT, Parser
from drivers.mavlink.transport import Peer, make_transport
from drivers.mavlink.vehicle import Vehicle
from drivers.xbee.receiver import open_receiver
from drivers.xbee.settings import advice
from fieldkit.clock import RealClock
from fieldkit.errors import DeviceError
from fieldkit.geo import FieldFrame
from fieldkit.ports import Surroundings

NOWHERE = FieldFrame(0.0, 0.0)
XBEE_HEARS = (
    "hears 802.15.4 data frames on its channel that are broadcast, or addressed to it, in its own PAN; "
    "cannot hear other PANs, other channels, ZigBee or DigiMesh networks"
)
_KNOWN = {
    (
        0x1915,
        0x154B,
    ): "Nordic 802.15.4 sniffer firmware: receiver 'nrf-sniffer', hears every 802.15.4 network",
    (0x0403, 0x6001): "FTDI serial adapter, as on XBee boards: name the port to ask it",
    (0x0403, 0x6015): "FTDI serial adapter, as on XBee boards: name the port to ask it",
    (0x10C4, 0xEA60): "CP210x serial adapter, as on XBee boards, Sonoff dongles and telemetry radios",
    (0x0451, 0xBEF3): "TI LaunchPad: with TI's sniffer firmware, receiver 'ti-sniffer'",
    (0x0451, 0x16AE): "CC2531 with TI's USB firmware: not a serial device, cannot be used",
    (0x2DAE, 0x1016): "CubePilot autopilot",
    (0x26AC, 0x0011): "PX4 autopilot",
    (0x1209, 0x5740): "ArduPilot autopilot",
}


@dataclass(frozen=True, slots=True)
class Found:
    """One port and what is known of it."""

    port: str
    what: str
    advice: list[str] = field(default_factory=list)


def ports() -> list[Found]:
    """Serial ports there are, by their USB identity alone: nothing is opened."""
    found = []
    for there in sorted(list_ports.comports()):
        if there.vid is None:
            continue
        words = _KNOWN.get((there.vid, there.pid), there.description or "unknown device")
        found.append(Found(there.device, f"{there.vid:04X}:{there.pid:04X} {words}"))
    return found


def ask_xbee(port: str, baud: int) -> Found:
    """Open a port as an XBee and tell what it is; errors are told, not raised."""
    return asyncio.run(_ask_xbee(port, baud))


async def _ask_xbee(port: str, baud: int) -> Found:
    receiver = open_receiver("this port", {"port": port, "baud": baud}, Surroundings(RealClock(), NOWHERE))
    try:
        async with receiver:
            settings = receiver.settings
    except DeviceError as error:
        return Found(port, f"not usable: {error}")
    assert settings is not None
    return Found(port, f"{settings.describe()}: {XBEE_HEARS}", advice(settings))


def heard_vehicles(address: str, duration_s: float) -> list[dict[str, Any]]:
    """Vehicles heard on a link; nothing is sent. Raises `ConfigError`, `DeviceError`."""
    return asyncio.run(_heard_vehicles(address, duration_s))


async def _heard_vehicles(address: str, duration_s: float) -> list[dict[str, Any]]:
    clock = RealClock()
    vehicles: dict[int, Vehicle] = {}
    parsers: dict[Peer, Parser] = {}

    def take(data: bytes, peer: Peer) -> None:
        for message in parsers.setdefault(peer, Parser()).parse(data):
            if message.get_srcComponent() == AUTOPILOT:
                number = message.get_srcSystem()
                vehicle = vehicles.setdefault(number, Vehicle(f"system {number}", number, NOWHERE))
                vehicle.heard(message, peer, clock.elapsed_s(), clock.now_ns())

    transport = make_transport(address)
    await transport.open(take)
    await clock.sleep(duration_s)
    await transport.close()
    return [_summary(vehicles[number]) for number in sorted(vehicles)]


def _summary(vehicle: Vehicle) -> dict[str, Any]:
    return {
        "system_id": vehicle.system_id,
        "firmware": vehicle.firmware.name if vehicle.firmware else "not one fieldkit steers",
        "mode": vehicle.actual_mode,
        "armed": vehicle.armed,
        "battery_pct": vehicle.battery_pct,
        "heartbeats": vehicle.heartbeats,
        "has_position": vehicle.position_s > float("-inf"),
        "address": str(vehicle.peer),
        "two_with_this_id": bool(vehicle.doubles),
        "texts": [text for _, text in vehicle.texts][-3:],
    }


def as_json(found: list[Found]) -> list[dict[str, Any]]:
    """For printing."""
    return [asdict(each) for each in found]
