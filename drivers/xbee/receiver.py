"""A robot's XBee as a `Receiver`: opens it, listens, notices when it is gone and takes it back."""

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

from digi.xbee.exception import InvalidOperatingModeException, XBeeException

from drivers.handover import Handover
from drivers.links import open_link
from drivers.options import checked
from drivers.xbee.decode import WITHOUT_RSSI, decode
from drivers.xbee.diagnose import why_silent
from drivers.xbee.listen import FrameInterface, ListenOnly
from drivers.xbee.settings import ModuleSettings, advice, read_settings, why_deaf
from fieldkit.errors import DeviceError, DeviceTimeout
from fieldkit.messages import ReceiverState, RssReading
from fieldkit.ports import Surroundings

logger = logging.getLogger(__name__)

REOPEN_EVERY_S = 0.5
"""Wall time between attempts to take an unplugged radio back."""


@dataclass(frozen=True, slots=True)
class XBeeOptions:
    """What a mission file says of a radio."""

    port: str
    """Device path, `socket://host:port`, `rfc2217://host:port` or another pyserial URL."""
    baud: int = 115200
    saturation_dbm: float | None = None
    """Readings from here up are marked saturated; default: what the module's hardware is known for."""
    channel: int | None = None
    """Where given, the module must be on this channel (CH)."""


def open_receiver(robot: str, options: Mapping[str, Any], around: Surroundings) -> "XBeeReceiver":
    """A receiver for `robot`, not opened yet. Raises `ConfigError` for options that cannot be."""
    return XBeeReceiver(robot, checked(XBeeOptions, options, f"receiver of {robot} (xbee)"), around)


class XBeeReceiver:
    """Entering opens the radio and checks its settings; readings come from then on until closed."""

    def __init__(self, robot: str, options: XBeeOptions, around: Surroundings) -> None:
        self.robot = robot
        self.settings: ModuleSettings | None = None
        """What the module said of itself when it was opened."""
        self.bad_readings = 0
        """Receptions without a usable strength: RSSI byte 0 or 255, or malformed."""
        self._options = options
        self._clock = around.clock
        self._device: ListenOnly | None = None
        self._listening = False
        self._closed = False
        self._overrun = 0

    async def __aenter__(self) -> Self:
        self._loop = asyncio.get_running_loop()
        self._handover: Handover[RssReading | ReceiverState] = Handover()
        self._lost = asyncio.Event()
        self._worker = ThreadPoolExecutor(1, thread_name_prefix=f"xbee-{self.robot}")
        try:
            await self._in_worker(self._open_device, True)
        except BaseException:
            await self._shut()
            raise
        assert self.settings is not None
        for line in advice(self.settings):
            logger.warning("%s: XBee on %s: %s", self.robot, self._options.port, line)
        self._keeper = asyncio.create_task(self._keep_open(), name=f"xbee-{self.robot}")
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._closed:
            return
        self._keeper.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await self._keeper
        await self._shut()

    async def readings(self) -> AsyncIterator[RssReading | ReceiverState]:
        """Readings and changes of state, in order; the first is the state after opening. For one consumer."""
        async for item in self._handover.items():
            yield item

    async def _in_worker(self, function: Any, *arguments: Any) -> None:
        await self._loop.run_in_executor(self._worker, function, *arguments)

    async def _shut(self) -> None:
        self._closed = True
        self._listening = False
        # Queued behind whatever the worker is at, so a device opened after a cancellation is closed too.
        await asyncio.shield(asyncio.ensure_future(self._in_worker(self._close_device)))
        self._worker.shutdown(wait=True)
        self._handover.close()

    async def _keep_open(self) -> None:
        """Take the radio back whenever it is lost."""
        while True:
            await self._lost.wait()
            self._lost.clear()
            logger.warning("%s: XBee on %s lost; trying to take it back", self.robot, self._options.port)
            await self._in_worker(self._close_device)
            last = ""
            while not self._listening:
                await asyncio.sleep(REOPEN_EVERY_S)
                try:
                    await self._in_worker(self._open_device, False)
                except DeviceError as error:
                    if str(error) != last:
                        last = str(error)
                        logger.info("%s", error)

    # What follows runs in the worker thread.

    def _open_device(self, first: bool) -> None:
        device = self._connect(diagnose=first)
        try:
            settings = self._accept(read_settings(device))
        except XBeeException as error:
            device.close()
            raise DeviceTimeout(f"{self._name}: stopped answering while opening: {error}") from error
        except BaseException:
            device.close()
            raise
        if self._closed:
            device.close()
            return
        self._device, self.settings = device, settings
        self._saturation_dbm = self._options.saturation_dbm or settings.saturation_dbm
        self._put(ReceiverState(self._clock.now_ns(), self.robot, True, settings.describe()))
        self._listening = True

    def _connect(self, *, diagnose: bool) -> ListenOnly:
        port, baud = self._options.port, self._options.baud
        interface = FrameInterface(
            lambda: open_link(port, baud, self._name), self._clock.now_ns, self._on_frame, self._on_lost
        )
        device = ListenOnly(interface)
        try:
            device.open()
        except InvalidOperatingModeException as error:
            device.close()
            if not diagnose or self._closed:
                raise DeviceTimeout(f"{self._name}: does not answer") from error
            raise DeviceTimeout(f"{self._name}: {self._why_silent()}") from error
        except XBeeException as error:
            device.close()
            raise DeviceTimeout(f"{self._name}: opening {port} failed: {error}") from error
        return device

    def _why_silent(self) -> str:
        link = open_link(self._options.port, self._options.baud, self._name)
        try:
            return why_silent(link, self._options.port, self._options.baud)
        finally:
            link.close()

    def _accept(self, settings: ModuleSettings) -> ModuleSettings:
        if reason := why_deaf(settings):
            raise DeviceError(f"{self._name}: the module on {self._options.port} {reason}")
        wanted = self._options.channel
        if wanted is not None and settings.channel != wanted:
            raise DeviceError(
                f"{self._name}: the module on {self._options.port} listens on channel {settings.channel}, "
                f"the mission wants {wanted}; set CH={wanted:X} with XCTU, or correct `channel`"
            )
        if self.settings is not None and settings.address != self.settings.address:
            raise DeviceError(
                f"{self._name}: {self._options.port} now holds module {settings.address}, "
                f"not {self.settings.address}; plug the right one back in"
            )
        return settings

    def _close_device(self) -> None:
        device, self._device = self._device, None
        if device is not None:
            device.close()

    @property
    def _name(self) -> str:
        return f"XBee of {self.robot}"

    # What follows runs in the library's reader thread.

    def _on_frame(self, t_ns: int, frame: bytes) -> None:
        if not self._listening:
            return
        heard = decode(frame)
        if heard is None:
            if 0x80 <= frame[3] <= 0x83:
                self.bad_readings += 1
            elif frame[3] in WITHOUT_RSSI:
                self.bad_readings += 1
                if self.bad_readings == 1:
                    logger.warning(
                        "%s: a frame without RSSI (0x%02X): has AO been changed?", self._name, frame[3]
                    )
            return
        self._put(
            RssReading(
                t_ns=t_ns,
                robot=self.robot,
                rss_dbm=heard.rss_dbm,
                via=heard.via,
                channel=self.settings.channel if self.settings else None,
                frame_id=heard.frame_id,
                saturated=heard.rss_dbm >= self._saturation_dbm,
            )
        )

    def _on_lost(self, reason: str) -> None:
        if not self._listening:
            return
        self._listening = False
        self._put(ReceiverState(self._clock.now_ns(), self.robot, False, reason), always=True)
        self._loop.call_soon_threadsafe(self._lost.set)

    def _put(self, item: RssReading | ReceiverState, *, always: bool = False) -> None:
        """Hand over; readings for which there is no room make the receiver count as down until there is."""
        if self._overrun:
            text = f"{self._overrun} readings lost: they came faster than they were taken"
            if self._handover.put(ReceiverState(item.t_ns, self.robot, True, text)):
                self._overrun = 0
        if self._handover.put(item, always=always):
            return
        if not self._overrun:
            text = "readings come faster than they are taken"
            self._handover.put(ReceiverState(item.t_ns, self.robot, False, text), always=True)
        self._overrun += 1
