"""A robot's XBee as a `Receiver`: opens it, listens, notices when it is gone and takes it back.

Where asked to, it also scans the channels' energy now and then, and says for how long its receiver was down by that.
"""

import asyncio
import contextlib
import logging
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Self

from digi.xbee.exception import InvalidOperatingModeException, XBeeException

from drivers.links import UsbIdentity, open_link, port_of, usb_identity
from drivers.options import PORT, checked
from drivers.reconnecting import ReconnectingReceiver
from drivers.xbee.decode import WITHOUT_RSSI, Heard, db_answer, decode, name_of
from drivers.xbee.diagnose import why_silent
from drivers.xbee.energy import energies, parameter
from drivers.xbee.last_hop import LastHop
from drivers.xbee.listen import FrameInterface, ListenOnly
from drivers.xbee.settings import SATURATION_DBM, ModuleSettings, advice, read_settings, why_it_cannot_hear
from fieldkit import settings as given
from fieldkit.errors import ConfigError, DeviceError, DeviceTimeout
from fieldkit.messages import ReceiverState, RssReading
from fieldkit.ports import DriverContext

logger = logging.getLogger(__name__)

REPLY_WITHIN_S = 2.0
"""How much longer than the scan itself an energy scan's answer may take."""


@dataclass(frozen=True, slots=True)
class XBeeOptions:
    """What a mission file says of a radio."""

    port: str = field(metadata=PORT)
    """Device path, `socket://host:port`, `rfc2217://host:port` or another pyserial URL."""
    baud: int = given.BAUD
    saturation_dbm: float | None = None
    """Readings from here up are marked saturated; default: what the module's hardware is known for."""
    channel: int | None = None
    """Where given, the module must be on this channel (CH)."""
    pan: int | None = None
    """Where given, the module must be in this PAN (ID)."""
    ask_db: bool = False
    """Take modules whose frames carry no strength, and ask ATDB after each: see `last_hop`."""
    energy_scan_s: float = 0.0
    """Length of an energy scan over all channels, wall time; 0: none. Its receiver is down meanwhile."""
    energy_scan_every_s: float = 60.0
    """Mission time between energy scans."""


def open_receiver(robot: str, options: Mapping[str, Any], around: DriverContext) -> "XBeeReceiver":
    """A receiver for `robot`, not opened yet. Raises `ConfigError` for options that cannot be."""
    where = f"receiver of {robot} (xbee)"
    chosen = checked(XBeeOptions, options, where)
    if not 0.0 <= chosen.energy_scan_s <= 15.0:
        raise ConfigError(
            f"{where}: option 'energy_scan_s': expected 0 to 15 seconds, got {chosen.energy_scan_s:g}"
        )
    if chosen.energy_scan_every_s < 0.0:
        raise ConfigError(f"{where}: option 'energy_scan_every_s': expected 0 or more")
    return XBeeReceiver(robot, chosen, around)


def open_survey(robot: str, options: Mapping[str, Any], around: DriverContext) -> "XBeeReceiver":
    """The receiver `ed`: energy scans back to back, on any firmware; hears packets only between them."""
    defaults = {"energy_scan_s": 2.0, "energy_scan_every_s": 0.0, "ask_db": True}
    return open_receiver(robot, defaults | dict(options), around)


class XBeeReceiver(ReconnectingReceiver):
    """Entering opens the radio and checks its settings; readings come from then on until closed."""

    def __init__(self, robot: str, options: XBeeOptions, around: DriverContext) -> None:
        super().__init__(robot, f"XBee of {robot}", around)
        self.settings: ModuleSettings | None = None
        """What the module said of itself when it was opened."""
        self.bad_readings = 0
        """Receptions without a usable strength: RSSI byte 0 or 255, or malformed."""
        self._options = options
        self._device: ListenOnly | None = None
        self._survey: asyncio.Task[None] | None = None
        self._last_hop = LastHop(mesh=False)
        self._saturation_dbm = SATURATION_DBM
        self._port = options.port
        self._usb: UsbIdentity | None = None

    async def __aenter__(self) -> Self:
        await super().__aenter__()
        if self._options.energy_scan_s > 0.0:
            self._survey = asyncio.create_task(self._keep_scanning(), name=f"energy-{self.robot}")
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        survey, self._survey = self._survey, None
        if survey is not None:
            survey.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await survey
        await super().__aexit__(kind, error, trace)

    async def _keep_scanning(self) -> None:
        while True:
            await self._in_worker(self._scan)
            await self._clock.sleep(max(0.1, self._options.energy_scan_every_s))

    def _scan(self) -> None:
        """One energy scan, down while it lasts; its readings are stamped within. In the worker thread."""
        device = self._device
        if device is None or not self._listening or self.settings is None:
            return
        command, lasts_s = parameter(self._options.energy_scan_s, legacy=self.settings.is_s1)
        began_ns = self._clock.now_ns()
        self._say(False, f"energy scan: receiver down for {lasts_s:.2f} s", began_ns)
        found: dict[int, float] = {}
        try:
            found = energies(device.scan_energy(command, lasts_s + REPLY_WITHIN_S))
            words = "energy scan: over" if found else "energy scan: an answer that makes no sense"
        except XBeeException as error:
            words = f"energy scan failed: {error}"
        ended_ns = self._clock.now_ns()
        for channel, rss_dbm in found.items():
            middle_ns = (began_ns + ended_ns) // 2
            self._give(RssReading(middle_ns, self.robot, rss_dbm, "ed", channel))
        self._say(True, f"{words}; receiver was down for {(ended_ns - began_ns) * 1e-9:.2f} s", ended_ns)

    def _say(self, up: bool, reason: str, t_ns: int) -> None:
        """A change of state, unless the device is lost: then it is down already."""
        with self._gate:
            if self._listening:
                self._put(ReceiverState(t_ns, self.robot, up, reason), always=True)

    def _open_device(self, first: bool) -> str:
        # Plugged in again, a USB adapter may get another name; only that very adapter is asked anything.
        if not first and self._usb is not None:
            self._port = port_of(self._usb) or self._options.port
        device = self._connect(diagnose=first)
        try:
            settings = self._accept(read_settings(device))
        except XBeeException as error:
            device.close()
            raise DeviceTimeout(f"{self._name}: stopped answering while opening: {error}") from error
        except BaseException:
            device.close()
            raise
        self._device, self.settings = device, settings
        self._last_hop = LastHop(mesh=settings.is_mesh)
        self._usb = self._usb or usb_identity(self._port)
        self._saturation_dbm = self._options.saturation_dbm or settings.saturation_dbm
        for line in advice(settings) if first else ():
            logger.warning("%s: %s: %s", self._name, self._port, line)
        return settings.describe()

    def _connect(self, *, diagnose: bool) -> ListenOnly:
        port, baud = self._port, self._options.baud
        interface = FrameInterface(
            lambda: self._watch(open_link(port, baud, self._name, self._tap)),
            self._clock,
            self._on_frame,
            self._on_lost,
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
        link = open_link(self._port, self._options.baud, self._name)
        try:
            return why_silent(link, self._port, self._options.baud)
        finally:
            link.close()

    def _accept(self, settings: ModuleSettings) -> ModuleSettings:
        if (reason := why_it_cannot_hear(settings)) and not self._options.ask_db:
            raise DeviceError(f"{self._name}: the module on {self._port} {reason}")
        wanted = self._options.channel
        if wanted is not None and settings.channel != wanted:
            raise DeviceError(
                f"{self._name}: the module on {self._port} listens on channel {settings.channel}, "
                f"the mission wants {wanted}; set CH={wanted:X} with XCTU, or correct `channel`"
            )
        pan = self._options.pan
        if pan is not None and settings.values["ID"] != pan:
            has = settings.values["ID"]
            raise DeviceError(
                f"{self._name}: the module on {self._port} is in PAN {'unknown' if has is None else f'{has:X}'}, "
                f"the mission wants {pan:X}; set ID={pan:X} with XCTU, or correct `pan`"
            )
        if self.settings is not None and settings.address != self.settings.address:
            raise DeviceError(
                f"{self._name}: {self._port} now holds module {settings.address}, "
                f"not {self.settings.address}; plug the right one back in"
            )
        return settings

    def _close_device(self) -> None:
        device, self._device = self._device, None
        if device is not None:
            device.close()

    # What follows runs in the library's reader thread.

    def _on_frame(self, t_ns: int, frame: bytes) -> None:
        kind = frame[3]
        if 0x80 <= kind <= 0x83:
            heard = decode(frame)
            if heard is None:
                self.bad_readings += 1
            else:
                self._reading(t_ns, heard)
        elif kind in WITHOUT_RSSI:
            self._without_strength(t_ns, frame)
        elif (answer := db_answer(frame)) is not None:
            asked = self._last_hop.answered(answer.number, time.monotonic())
            if asked is not None and answer.rss_dbm is not None:
                self._reading(asked.t_ns, Heard(answer.rss_dbm, "db", asked.frame_id))

    def _without_strength(self, t_ns: int, frame: bytes) -> None:
        """A reception that does not say how strong it was: ask, where that is wanted."""
        name, device = name_of(frame), self._device
        if name is None or device is None or not self._options.ask_db:
            self.bad_readings += 1
            if self.bad_readings == 1:
                logger.warning(
                    "%s: a frame without RSSI (0x%02X): has AO been changed?", self._name, frame[3]
                )
            return
        number = self._last_hop.received(t_ns, name, time.monotonic())
        if number is not None:
            with contextlib.suppress(XBeeException):  # unplugged: the next read notices
                device.ask_db(number)

    def _reading(self, t_ns: int, heard: Heard) -> None:
        self._give(
            RssReading(
                t_ns=t_ns,
                robot=self.robot,
                rss_dbm=heard.rss_dbm,
                via=heard.via,
                channel=self.settings.channel if self.settings else None,
                frame_id=heard.frame_id,
                saturated=heard.rss_dbm >= self._saturation_dbm,
                sensitivity_dbm=self.settings.sensitivity_dbm if self.settings else None,
            )
        )
