"""Any radio that prints as a `Receiver`.

Silence is known to be silence only while the radio is known to work: with `heartbeat_s` the receiver counts as down
when no line at all has come for so long; without it, it counts as up while its port is open. A receiver whose lines
make no sense under its map counts as down too, and says which line and what is missing.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

from drivers.lines.mapping import Heard, LineMap, NoReadingError
from drivers.lines.maps import MAPS
from drivers.lines.sources import PORTS, open_source, refused_scheme
from drivers.links import ByteLink, absent, arrival_ns
from drivers.options import REMEDY, checked
from drivers.threaded import ThreadedReceiver
from drivers.timebase import DeviceStamps
from fieldkit import settings as given
from fieldkit.errors import ConfigError
from fieldkit.messages import ReceiverState, RssReading
from fieldkit.ports import DriverContext

LONGEST_LINE = 65_536
RETURNS = 3
"""So many carriage returns and no new line: the device ends its lines with the former."""
SENSELESS = 5
"""So many lines in a row that are no readings, and the receiver counts as down until one is."""
MOST_S = 1e12
"""A stamp further from 1970 is none."""
SHOWN = 80
"""Of a line that makes no sense so much is shown."""


@dataclass(frozen=True, slots=True)
class LinesOptions:
    """What a mission file says of a radio that prints."""

    port: str = field(
        metadata={
            REMEDY: 'write whence its lines come, as in port = "/dev/ttyUSB0", "udp://0.0.0.0:5005", '
            '"mqtt://host/topic" or the path of a file; "fieldkit devices" lists what is plugged in'
        }
    )
    map: str = ""
    """A ready-made map; the keys below change it, or make one where none is named."""
    format: str | None = None
    pattern: str | None = None
    columns: list[Any] | None = None
    rss: str | None = None
    unit: str | None = None
    offset_db: float | None = None
    source: str | None = None
    channel: str | None = None
    time: str | None = None
    time_unit: str | None = None
    number: str | None = None
    heard: str | None = None
    only: str | None = None
    """Readings of this source alone; others are passed over."""
    only_channel: int | None = None
    heartbeat_s: float | None = None
    """Mission time without any line after which the radio counts as down."""
    from_start: bool = False
    """Of a file: read what is in it already."""
    baud: int = given.BAUD
    saturation_dbm: float | None = None


def open_receiver(robot: str, options: Mapping[str, Any], around: DriverContext) -> "LinesReceiver":
    """A radio that prints, not opened yet. Raises `ConfigError`."""
    where = f"receiver of {robot} (lines)"
    given = checked(LinesOptions, options, where)
    if given.heartbeat_s is not None and not given.heartbeat_s > 0:
        raise ConfigError(f"{where}: option 'heartbeat_s': expected above 0, got {given.heartbeat_s:g}")
    if refused := refused_scheme(given.port):
        raise ConfigError(f"{where}: option 'port': {given.port}: {refused}; a port may be {PORTS}")
    return LinesReceiver(robot, given, map_of(given, where), around)


def map_of(options: LinesOptions, where: str) -> LineMap:
    """The map that the options name or make. Raises `ConfigError`."""
    if options.map and options.map not in MAPS:
        raise ConfigError(f"{where}: option 'map': expected one of {', '.join(MAPS)}, got {options.map!r}")
    if not options.map and options.format is None:
        raise ConfigError(
            f"{where}: expected 'map' (one of {', '.join(MAPS)}), or 'format' with the keys of a map of your own; "
            "'fieldkit devices --watch PORT' shows what comes in and proposes one"
        )
    own: dict[str, Any] = {}
    for each in fields(LineMap):
        value = getattr(options, each.name, None)
        if value is not None:
            own[each.name] = tuple(map(str, value)) if each.name == "columns" else value
    base = MAPS[options.map] if options.map else LineMap(own["format"])
    made = replace(base, **own)
    made.check(where)
    return made


@dataclass(slots=True)
class LineSplitter:
    """Bytes in, lines out; a line that is too long is dropped whole."""

    dropped: int = 0
    ended: int = 0
    """Lines so far, also empty ones and those that were dropped."""
    _returns: bool = False
    """A carriage return ends a line too: the device was seen to print nothing else."""
    _rest: bytes = b""
    _dropping: bool = field(default=False)

    @property
    def is_dropping(self) -> bool:
        """In the middle of a line that is too long."""
        return self._dropping

    def feed(self, data: bytes) -> list[str]:
        """Whole lines, without their ends and byte order marks; what is no UTF-8 becomes replacement characters."""
        if self._returns:
            data = data.replace(b"\r", b"\n")
        *whole, rest = (self._rest + data).split(b"\n")
        if not self.ended and not whole and rest.count(b"\r") >= RETURNS:
            self._returns = True
            *whole, rest = rest.replace(b"\r", b"\n").split(b"\n")
        self.ended += len(whole)
        if whole and self._dropping:
            del whole[0]
            self._dropping = False
        if len(rest) > LONGEST_LINE:
            self.dropped += not self._dropping
            self._dropping, rest = True, b""
        self._rest = rest
        lines = [
            line.decode("utf-8", "replace").strip("\ufeff\r \t\x00")
            for line in whole
            if len(line) <= LONGEST_LINE
        ]
        return [line for line in lines if line]


class LinesReceiver(ThreadedReceiver):
    """Entering opens the port and reads; nothing is sent."""

    def __init__(self, robot: str, options: LinesOptions, line_map: LineMap, around: DriverContext) -> None:
        super().__init__(robot, f"lines of {robot}", around)
        self._options, self._map = options, line_map
        self._link: ByteLink | None = None

    def _open_device(self, first: bool) -> str:
        options = self._options
        # What was printed while the port was away has been missed either way.
        start = options.from_start and first
        source = open_source(options.port, options.baud, self._name, from_start=start, tap=self._tap)
        self._link = self._watch(source)
        self._split, self._stamps = LineSplitter(), DeviceStamps()
        self._senseless, self._down, self._alone = 0, False, False
        self._read_by(self._read, self._link)
        return f"lines from {options.port} as {options.map or self._map.format}"

    def _close_device(self) -> None:
        self._stop_reading()
        link, self._link = self._link, None
        if link is not None:
            link.close()

    # What follows runs in the reader thread.

    def _read(self, link: ByteLink) -> None:
        self._line_s = self._clock.elapsed_s()
        while self._running.is_set():
            try:
                data = link.read()
            except (
                OSError,
                TypeError,
                AttributeError,
                ValueError,
            ) as error:  # pyserial's, when closed under a read
                self._on_lost(f"the port went away ({error})")
                return
            ended, lines = self._split.ended, self._split.feed(data) if data else []
            if lines:
                t_ns = arrival_ns(link, self._clock)
                for line in lines:
                    if not self._running.is_set():  # a pattern may think for long about each of thousands
                        return
                    self._take(line, t_ns)
            self._mind_the_silence(self._split.ended > ended, absent(link))

    def _mind_the_silence(self, came: bool, nobody: str) -> None:
        """Whether what is not heard means anything. An end of line is a sign of life; other bytes are none."""
        now_s, limit_s = self._clock.elapsed_s(), self._options.heartbeat_s
        if came:
            self._line_s = now_s
            if self._down and self._senseless == 0:
                self._set_down(False, "lines come again")
        elif nobody:
            if not self._down:
                self._set_down(True, nobody)
                self._alone = True
        elif self._alone:
            self._set_down(False, "somebody is there again")
        elif self._split.is_dropping:
            if not self._down:
                self._set_down(True, f"it has printed {LONGEST_LINE} bytes without an end of line")
        elif limit_s is not None and not self._down and now_s - self._line_s > limit_s:
            self._set_down(True, f"no line for {now_s - self._line_s:.0f} s")

    def _set_down(self, down: bool, reason: str) -> None:
        self._down, self._alone = down, False
        with self._gate:
            if self._listening:
                self._put(ReceiverState(self._clock.now_ns(), self.robot, not down, reason), always=True)

    def _take(self, line: str, t_ns: int) -> None:
        try:
            heard = self._map.read(line)
        except NoReadingError as error:
            self._senseless += 1
            if self._senseless == SENSELESS and not self._down:
                self._set_down(True, f"its lines are no readings: {line[:SHOWN]!r} {error}")
            return
        self._senseless = 0
        if self._down:
            self._set_down(False, "its lines are readings")
        if heard is not None and self._is_wanted(heard):
            self._give(self._reading(heard, t_ns))

    def _is_wanted(self, heard: Heard) -> bool:
        options = self._options
        return (options.only is None or heard.source == options.only) and (
            options.only_channel is None or heard.channel == options.only_channel
        )

    def _reading(self, heard: Heard, t_ns: int) -> RssReading:
        ceiling = self._options.saturation_dbm
        return RssReading(
            t_ns=self._mission_time(heard.time_s, t_ns),
            robot=self.robot,
            rss_dbm=heard.rss_dbm,
            via="lines",
            channel=heard.channel,
            frame_id=heard.frame_id(),
            saturated=ceiling is not None and heard.rss_dbm >= ceiling,
        )

    def _mission_time(self, by_radio_s: float | None, t_ns: int) -> int:
        """The radio's own stamp in mission time, however far its clock is off; the arrival where it gives none."""
        stamped = by_radio_s is not None and abs(by_radio_s) <= MOST_S
        return self._stamps.of(round(by_radio_s * 1e9) if stamped and by_radio_s is not None else None, t_ns)


def watch(port: str, baud: int, seconds: float, show: Callable[[str], None] = lambda line: None) -> list[str]:
    """The lines that come in within `seconds` of wall time, or until Ctrl-C; each is shown as it comes.

    Raises `DeviceError`.
    """
    link, split = open_source(port, baud, "watch", from_start=True), LineSplitter()
    lines: list[str] = []
    try:
        until_s = time.monotonic() + seconds
        while time.monotonic() < until_s and len(lines) < 1_000:
            for line in split.feed(link.read()):
                lines.append(line)
                show(line)
    except (OSError, KeyboardInterrupt):
        pass  # it has ended, or enough was seen: what came is what there is
    finally:
        link.close()
    return lines
