"""Where somebody stands, before there is a field; and whether their radio is there, before they wait for that."""

import asyncio
from pathlib import Path

from fieldkit import plugins
from fieldkit.clock import RealClock
from fieldkit.errors import DeviceTimeout
from fieldkit.geo import FieldFrame
from fieldkit.ports import DriverContext, Receiver
from fieldkit.settings import WALKER

NEARBY_DEG = 0.01


def must_open(receiver: Receiver, port: str) -> None:
    """Raises `DeviceError` where the device of a receiver cannot be opened by now.

    Whoever is at the far end of a network or writes into a pipe would notice, and may not come back: those are left
    alone, and so is standard input.
    """
    if "://" in port or port == "-" or Path(port).is_fifo():
        return

    async def open_once() -> None:
        async with receiver:
            pass

    asyncio.run(open_once())


async def first_fix(port: str, patience_s: float) -> tuple[float, float]:
    """Latitude and longitude of the first position that is plausible. Raises `DeviceError`."""
    # A local frame needs an origin; any does for reading a latitude and longitude back out of it.
    frame = FieldFrame(0.0, 0.0)
    source = plugins.load("fieldkit.positions", "gnss")(
        {"robots": {WALKER: port}}, DriverContext(RealClock(), frame)
    )
    try:
        async with asyncio.timeout(patience_s), source as opened:
            async for pose in opened.poses():
                lat_deg, lon_deg, _ = frame.to_geodetic(pose.east_m, pose.north_m, pose.up_m)
                return lat_deg, lon_deg
    except TimeoutError:
        why = source.absent.get(WALKER, "nothing came")
        raise DeviceTimeout(
            f"{port}: no position within {patience_s:.0f} s ({why}); go where the sky is free"
        ) from None
    raise DeviceTimeout(f"{port}: closed before it gave a position")
