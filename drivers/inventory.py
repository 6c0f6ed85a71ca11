"""What is plugged in and what it can and cannot hear; which vehicles are heard on a link."""

import asyncio
from dataclasses import asdict, dataclass, field
from typing import Any

from serial.tools import list_ports

from drivers.mavlink.codec import AUTOPILOT, Parser
from drivers.mavlink.transport import Peer, make_transport
from drivers.mavlink.vehicle import Vehicle
from drivers.sniffers.receiver import open_nrf, open_ti
from drivers.xbee.receiver import open_receiver
from drivers.xbee.settings import advice, why_it_cannot_hear
from fieldkit.clock import RealClock
from fieldkit.errors import DeviceError, DeviceTimeout
from fieldkit.geo import FieldFrame
from fieldkit.ports import DriverContext

NOWHERE = FieldFrame(0.0, 0.0)
MESH_HEARS = (
    "hears its own mesh network only; cannot hear other PANs, plain 802.15.4 senders or other channels, and its "
    "frames carry no strength"
)
SNIFFER_HEARS = (
    "hears every 802.15.4 frame on the channel it is set to, whoever it is for; one channel at a time"
)
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
    settings: dict[str, str] = field(default_factory=dict)
    """AT name to its value in hexadecimal, of an XBee that answered."""
    answered: bool = True
    """Whether the port is there, and what is on it was recognised."""


def ports() -> list[Found]:
    """Serial ports there are, by their USB identity alone: nothing is opened."""
    found = []
    for there in sorted(list_ports.comports()):
        if there.vid is None:
            continue
        words = _KNOWN.get((there.vid, there.pid), there.description or "unknown device")
        found.append(Found(there.device, f"{there.vid:04X}:{there.pid:04X} {words}"))
    return found


def ask(port: str, baud: int) -> Found:
    """Open a port, as an XBee and then as a sniffer dongle, and say what it is; no error is raised."""
    return asyncio.run(_ask(port, baud))


async def _ask(port: str, baud: int) -> Found:
    around = DriverContext(RealClock(), NOWHERE)
    receiver = open_receiver("this port", {"port": port, "baud": baud, "ask_db": True}, around)
    try:
        async with receiver:
            settings = receiver.settings
    except DeviceTimeout as error:
        return await _ask_sniffers(port, around) or _unanswered(port, error)
    except DeviceError as error:
        return _unanswered(port, error)
    assert settings is not None
    hears = MESH_HEARS if settings.is_mesh else XBEE_HEARS
    reason = why_it_cannot_hear(settings)
    what = f"{settings.describe()}: " + (f"not usable as it is: {reason}; {hears}" if reason else hears)
    values = {"AP": settings.api_mode} | settings.values
    shown = {name: f"{value:X}" for name, value in values.items() if value is not None}
    return Found(port, what, advice(settings), shown)


def _unanswered(port: str, error: DeviceError) -> Found:
    return Found(port, f"not usable: {error}", answered=False)


async def _ask_sniffers(port: str, around: DriverContext) -> Found | None:
    for opener, name in ((open_nrf, "nrf-sniffer"), (open_ti, "ti-sniffer")):
        try:
            async with opener("this port", {"port": port}, around):
                return Found(port, f"802.15.4 sniffer dongle: receiver '{name}', {SNIFFER_HEARS}")
        except DeviceError:
            continue
    return None


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
        "place_deg": None if vehicle.place is None else [each / 1e7 for each in vehicle.place],
        "address": str(vehicle.peer),
        "two_with_this_id": bool(vehicle.doubles),
        "texts": [text for _, text, _ in vehicle.texts][-3:],
    }


def as_json(found: list[Found]) -> list[dict[str, Any]]:
    """For printing."""
    return [asdict(each) for each in found]
