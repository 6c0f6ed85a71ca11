"""Where somebody stands, before there is a field."""

import asyncio

from fieldkit import plugins
from fieldkit.clock import RealClock
from fieldkit.errors import DeviceTimeout
from fieldkit.geo import FieldFrame
from fieldkit.ports import DriverContext
from fieldkit.settings import WALKER

NEARBY_DEG = 0.01


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
