"""A mission under way for ATAK, WinTAK and iTAK: Cursor on Target over UDP (also multicast) and TCP.

A thread with its own loop sends the present every few seconds: a network, slow or dead, never delays the mission. What
cannot be reached is said once, and tried again for as long as the mission lasts. Nothing is received.
"""

import asyncio
import contextlib
import logging
import re
import threading
from collections.abc import Callable
from types import TracebackType
from typing import Any, Self

from fieldkit import settings as given
from fieldkit.recording import cot
from fieldkit.recording.cot import Marker
from fieldkit.settings import ELLIPSE_90
from mission.maps.geojson import error_90_m
from mission.maps.present import Latest, Present

logger = logging.getLogger(__name__)

AGAIN_S = 3.0
"""Wall time before a connection is tried again."""
SEND_TIMEOUT_S = 5.0
ENDING_S = 5.0
STALE_PERIODS = 4.0
"""So many periods without a newer event, and it is shown as old."""
FOUND_LASTS_S = 86_400.0
"""What was found, and what a person has marked, stays on the map when the mission is over."""


def markers(present: Present, every_s: float) -> list[Marker]:
    """The present as events. Uids are those of this mission: another one of the same name has others."""
    mission = re.sub(r"[^\w.-]", "-", present.name)
    base, lasts_s = f"fieldkit-{mission}-{present.began_ns // 1_000_000_000}", STALE_PERIODS * every_s
    made = []

    def add(uid: str, kind: str, how: str, place: tuple[float, float], **more: Any) -> None:
        lat_deg, lon_deg, _ = present.frame.to_geodetic(*place)
        made.append(Marker(f"{base}-{uid}", kind, how, lat_deg, lon_deg, **more))

    for source in present.sources:
        found = source.state == "found"
        sender = f", sender {source.name}" if source.name else ""
        add(
            f"source-{source.ident}", cot.UNKNOWN_GROUND, cot.FUSED, (source.east_m, source.north_m),
            error_90_m=error_90_m(source), callsign=f"source {source.ident}{'' if found else '?'}",
            remarks=f"{source.state}, {source.p_here:.0%} here, {source.receptions:.0f} receptions{sender}",
            t_ns=present.t_ns, stale_s=FOUND_LASTS_S if found else lasts_s,
        )  # fmt: skip
    for pose in present.poses:
        flies = pose.robot in present.flying
        add(
            f"robot-{pose.robot.replace(' ', '-')}", cot.FRIEND_ROTARY if flies else cot.FRIEND_GROUND,
            cot.BY_SATELLITE, (pose.east_m, pose.north_m), error_90_m=ELLIPSE_90 * pose.sigma_m,
            callsign=pose.robot, remarks="", t_ns=pose.t_ns, stale_s=lasts_s,
        )  # fmt: skip
    for mark in present.marks:
        add(
            f"mark-{mark.number}", cot.SPOT, cot.ESTIMATED, (mark.east_m, mark.north_m), error_90_m=None,
            callsign=f"{mark.by}: here", remarks="a person's word", t_ns=mark.t_ns, stale_s=FOUND_LASTS_S,
        )  # fmt: skip
    return made


class CotSender:
    """Sends while it is entered; `latest` is the follower it sends from."""

    def __init__(
        self, latest: Latest, addresses: tuple[str, ...], every_s: float = given.COT_EVERY_S.default
    ) -> None:
        self.latest = latest
        self.sent = dict.fromkeys(addresses, 0)
        """Events that went out to each address."""
        self._every_s = every_s
        self._loop: asyncio.AbstractEventLoop | None = None
        self._ready, self._ending = threading.Event(), asyncio.Event()
        self._thread = threading.Thread(target=self._run, name="cursor on target", daemon=True)

    def __enter__(self) -> Self:
        cot.load_pytak()
        self._thread.start()
        self._ready.wait(ENDING_S)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._loop is not None:
            with contextlib.suppress(RuntimeError):  # it has ended by itself
                self._loop.call_soon_threadsafe(self._ending.set)
        self._thread.join(ENDING_S + SEND_TIMEOUT_S)

    def _run(self) -> None:
        async def send() -> None:
            self._loop = asyncio.get_running_loop()
            self._ready.set()
            await asyncio.gather(*(self._serve(address) for address in self.sent))

        try:
            asyncio.run(send())
        except Exception:  # the map is not the mission: it may fail, and says so
            logger.exception("nothing more goes out by Cursor on Target; the mission goes on")
        finally:
            self._ready.set()

    async def _serve(self, address: str) -> None:
        """One address, until the mission is over; the last present goes out at the end."""
        failed = False
        while True:
            try:
                async with _opened(address) as write:
                    if failed:
                        logger.warning("%s: reached again", address)
                        failed = False
                    await self._send_on(address, write)
                    return
            except (OSError, TimeoutError) as error:
                if not failed:
                    logger.warning(
                        "%s: cannot be reached (%s); tried again while the mission lasts", address, error
                    )
                failed = True
            if await self._pause(AGAIN_S):
                return

    async def _send_on(self, address: str, write: Callable[[bytes], Any]) -> None:
        while True:
            over = self._ending.is_set()
            present = self.latest.present()
            for marker in markers(present, self._every_s) if present.t_ns else ():
                async with asyncio.timeout(SEND_TIMEOUT_S):
                    await write(cot.event(marker))
                self.sent[address] += 1
            if over:
                return
            await self._pause(self._every_s)

    async def _pause(self, seconds: float) -> bool:
        """Whether the mission is over meanwhile."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                await self._ending.wait()
        return self._ending.is_set()


@contextlib.asynccontextmanager
async def _opened(address: str) -> Any:
    """What writes to an address. Raises `OSError`, `TimeoutError`."""
    scheme, _, rest = address.partition("://")
    # Write only: of UDP nothing is bound, so that a TAK program on this machine keeps its port.
    config = {"COT_URL": f"{scheme}+wo://{rest}" if scheme == "udp" else address}
    async with asyncio.timeout(SEND_TIMEOUT_S):
        reader, writer = await cot.load_pytak().protocol_factory(config)
    draining = asyncio.create_task(_drain(reader)) if reader is not None else None

    async def write(data: bytes) -> None:
        if hasattr(writer, "send"):
            await writer.send(data)
            return
        if draining is not None and draining.done():
            raise ConnectionResetError("the connection was closed")
        writer.write(data)
        await writer.drain()

    try:
        yield write
    finally:
        if draining is not None:
            draining.cancel()
            await asyncio.wait({draining})
        writer.close()
        if hasattr(writer, "wait_closed"):
            with contextlib.suppress(OSError, TimeoutError):
                async with asyncio.timeout(SEND_TIMEOUT_S):
                    await writer.wait_closed()


async def _drain(reader: asyncio.StreamReader) -> None:
    """A server sends what others see; nobody here asks. Ends when it closes."""
    with contextlib.suppress(OSError):
        while await reader.read(65_536):
            pass
