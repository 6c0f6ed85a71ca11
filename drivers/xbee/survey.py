"""Which channels are in use, by a module's energy scans: the receiver `ed`, run for a while."""

import asyncio
from typing import Any

from drivers.xbee.receiver import open_survey
from fieldkit.clock import RealClock
from fieldkit.errors import DeviceError
from fieldkit.geo import FieldFrame
from fieldkit.messages import ReceiverState, RssReading
from fieldkit.ports import DriverContext

FAILURES = 3
"""Scans in a row without an answer after which a module counts as one that cannot scan."""


def occupancy(port: str, baud: int, scans: int, scan_s: float, busy_dbm: float) -> dict[str, Any]:
    """Per channel: mean and strongest energy, the share of scans that found it busy; how long nothing was received.

    `over_time` has every scan: its time and each channel's energy. Raises `DeviceError`.
    """
    return asyncio.run(_occupancy(port, baud, scans, scan_s, busy_dbm))


async def _occupancy(port: str, baud: int, scans: int, scan_s: float, busy_dbm: float) -> dict[str, Any]:
    options = {"port": port, "baud": baud, "energy_scan_s": scan_s, "energy_scan_every_s": 0.0}
    over_time: list[dict[str, Any]] = []
    levels: dict[int, float] = {}
    receiver_down_ns = began_ns = failures = 0
    async with open_survey(
        "this port", options, DriverContext(RealClock(), FieldFrame(0.0, 0.0))
    ) as receiver:
        async for item in receiver.readings():
            if isinstance(item, RssReading):
                if item.via == "ed" and item.channel is not None:
                    levels[item.channel] = item.rss_dbm
                continue
            began_ns, receiver_down_ns, scanned = _state(item, began_ns, receiver_down_ns)
            if not scanned:
                continue
            failures = 0 if levels else failures + 1
            if failures == FAILURES:
                raise DeviceError(f"{port}: {item.reason}; does this firmware know ED?")
            if levels:
                over_time.append({"t_ns": item.t_ns, "energy_dbm": levels})
                levels = {}
            if len(over_time) == scans:
                break
    return _summary(over_time, receiver_down_ns * 1e-9, busy_dbm)


def _state(state: ReceiverState, began_ns: int, receiver_down_ns: int) -> tuple[int, int, bool]:
    """(when its receiver went down, for how long so far, whether a scan has ended)."""
    if not state.up:
        if not state.reason.startswith("energy scan"):
            raise DeviceError(f"the radio was lost: {state.reason}")
        return state.t_ns, receiver_down_ns, False
    if not began_ns:
        return 0, receiver_down_ns, False
    return 0, receiver_down_ns + state.t_ns - began_ns, True


def _summary(over_time: list[dict[str, Any]], not_listening_s: float, busy_dbm: float) -> dict[str, Any]:
    channels = []
    for channel in sorted({each for scan in over_time for each in scan["energy_dbm"]}):
        found = [scan["energy_dbm"][channel] for scan in over_time if channel in scan["energy_dbm"]]
        channels.append(
            {
                "channel": channel,
                "mean_dbm": round(sum(found) / len(found), 1),
                "strongest_dbm": max(found),
                "busy_share": round(sum(level >= busy_dbm for level in found) / len(over_time), 3),
            }
        )
    return {
        "scans": len(over_time),
        "not_listening_s": round(not_listening_s, 2),
        "channels": channels,
        "over_time": over_time,
    }
