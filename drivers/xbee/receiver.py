"""A robot's XBee as a `Receiver`: opens it, listens, notices when it is gone and takes it back."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from digi.xbee.exception import InvalidOperatingModeException, XBeeException

from drivers.keeper import KeptReceiver
from drivers.links import UsbIdentity, open_link, port_of, usb_identity
from drivers.options import checked
from drivers.xbee.decode import WITHOUT_RSSI, decode
from drivers.xbee.diagnose import why_silent
from drivers.xbee.listen import FrameInterface, ListenOnly
from drivers.xbee.settings import SATURATION_DBM, ModuleSettings, advice, read_settings, why_deaf
from fieldkit.errors import DeviceError, DeviceTimeout
from fieldkit.messages import RssReading
from fieldkit.ports import Surroundings

logger = logging.getLogger(__name__)


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


class XBeeReceiver(KeptReceiver):
    """Entering opens the radio and checks its settings; readings come from then on until closed."""

    def __init__(self, robot: str, options: XBeeOptions, around: Surroundings) -> None:
        super().__init__(robot, f"XBee of {robot}", around)
        self.settings: ModuleSettings | None = None
        """What the module said of itself when it was opened."""
        self.bad_readings = 0
        """Receptions without a usable strength: RSSI byte 0 or 255, or malformed."""
        self._options = options
        self._device: ListenOnly | None = None
        self._saturation_dbm = SATURATION_DBM
        self._port = options.port
        self._usb: UsbIdentity | None = None

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
        self._usb = self._usb or usb_identity(self._port)
        self._saturation_dbm = self._options.saturation_dbm or settings.saturation_dbm
        for line in advice(settings) if first else ():
            logger.warning("%s: %s: %s", self._name, self._port, line)
        return settings.describe()

    def _connect(self, *, diagnose: bool) -> ListenOnly:
        port, baud = self._port, self._options.baud
        interface = FrameInterface(
            lambda: open_link(port, baud, self._name), self._clock, self._on_frame, self._on_lost
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
        if reason := why_deaf(settings):
            raise DeviceError(f"{self._name}: the module on {self._port} {reason}")
        wanted = self._options.channel
        if wanted is not None and settings.channel != wanted:
            raise DeviceError(
                f"{self._name}: the module on {self._port} listens on channel {settings.channel}, "
                f"the mission wants {wanted}; set CH={wanted:X} with XCTU, or correct `channel`"
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
        self._give(
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
