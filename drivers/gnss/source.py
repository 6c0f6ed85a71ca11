"""Satellite navigation receivers as a `PositionSource`: one robot, or one person, each."""

import asyncio
import contextlib
import logging
import math
import threading
import time
from collections.abc import AsyncIterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Self

from drivers.bounded_queue import BoundedQueue
from drivers.gnss.fixes import Fix, FixJudge
from drivers.gnss.gpsd import GPSD_PORT, WATCH, GpsdReader
from drivers.gnss.nmea import NmeaReader
from drivers.lines.sources import open_source, refused_scheme
from drivers.links import ByteLink, arrival_ns, device_and_baud
from drivers.options import checked
from drivers.timebase import DeviceStamps
from fieldkit.errors import ConfigError, DeviceError
from fieldkit.messages import Pose
from fieldkit.ports import DriverContext

logger = logging.getLogger(__name__)

AGAIN_S = 0.5
"""Wall time between attempts to take a lost receiver back."""
NO_SENTENCE_S = 10.0
"""Wall time without one whole sentence after which it is said what comes instead."""
NO_HEADING_M_S = 0.3
"""Slower than this a course over ground is noise: the last one holds."""

PORTS = (
    "gpsd://HOST[:PORT], or where NMEA comes from: DEVICE[:BAUD], socket://HOST:PORT, "
    "tcp://HOST:PORT (waits for connections), udp://HOST:PORT"
)


@dataclass(frozen=True, slots=True)
class GnssOptions:
    """What a mission file says of its satellite receivers."""

    robots: dict[str, Any] = field(default_factory=dict)
    """Robot to its receiver: one of `PORTS`."""
    baud: int = 9600
    max_speed_m_s: float = 15.0
    """No robot and no person is faster: a fix further away has jumped."""
    worst_sigma_m: float = 25.0
    """A position that is worse is absent."""


def open_gnss(options: Mapping[str, Any], around: DriverContext) -> "GnssSource":
    """Receivers as one source, not opened yet. Raises `ConfigError`."""
    where = "positions (gnss)"
    chosen = checked(GnssOptions, options, where)
    if not chosen.robots:
        raise ConfigError(
            f'{where}: robots: expected a robot with its receiver, as in {{ ada = "/dev/ttyACM0" }}'
        )
    for robot, port in chosen.robots.items():
        if not isinstance(port, str) or not port:
            raise ConfigError(f"{where}: robots.{robot}: expected a port, got {port!r}")
        if not port.startswith("gpsd://") and (refused := refused_scheme(port)):
            raise ConfigError(f"{where}: robots.{robot}: {port}: {refused}; expected {PORTS}")
        if list(chosen.robots.values()).count(port) > 1:
            raise ConfigError(
                f"{where}: robots.{robot}: {port} is given to two robots; each has a receiver of its own"
            )
    for key in ("max_speed_m_s", "worst_sigma_m"):
        if not getattr(chosen, key) > 0.0:
            raise ConfigError(f"{where}: {key}: expected above 0, got {getattr(chosen, key):g}")
    return GnssSource(chosen, around)


class GnssSource:
    """Entering opens all receivers; one that is lost is taken back, and its robot is absent meanwhile."""

    def __init__(self, options: GnssOptions, around: DriverContext) -> None:
        self.robots = tuple(options.robots)
        self.absent: dict[str, str] = {}
        """Robot to why it has no position now."""
        self._options, self._around = options, around
        self._threads: list[threading.Thread] = []

    async def __aenter__(self) -> Self:
        self._queue: BoundedQueue[Pose] = BoundedQueue()
        self._stopping = threading.Event()
        loop = asyncio.get_running_loop()
        links: dict[str, ByteLink] = {}
        with ThreadPoolExecutor(1, thread_name_prefix="gnss-open") as worker:
            try:
                for robot, port in self._options.robots.items():
                    links[robot] = await loop.run_in_executor(worker, self._open, robot, port)
            except BaseException:
                for link in links.values():
                    link.close()
                raise
        for robot, link in links.items():
            thread = threading.Thread(
                target=self._follow, args=(robot, link), name=f"gnss-{robot}", daemon=True
            )
            self._threads.append(thread)
            thread.start()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stopping.set()
        threads, self._threads = self._threads, []
        for thread in threads:
            await asyncio.get_running_loop().run_in_executor(None, thread.join)
        self._queue.close()

    async def poses(self) -> AsyncIterator[Pose]:
        """For one consumer at a time."""
        async for pose in self._queue.items():
            yield pose

    def _open(self, robot: str, port: str) -> ByteLink:
        """Raises `DeviceError`."""
        name, tap = f"GNSS of {robot}", self._around.tap
        shown = None if tap is None else lambda data: tap(f"{robot}-gnss", data)
        if not port.startswith("gpsd://"):
            return open_source(port, self._options.baud, name, from_start=False, tap=shown)
        where, _, _ = port.removeprefix("gpsd://").partition("/")
        if ":" not in where:
            where = f"{where or '127.0.0.1'}:{GPSD_PORT}"
        try:
            link = open_source(f"socket://{where}", self._options.baud, name, from_start=False, tap=shown)
        except DeviceError as error:
            why = getattr(error.__cause__, "strerror", None) or str(error.__cause__ or error)
            raise DeviceError(
                f"{name}: {port}: {why[:1].lower()}{why[1:]}; is gpsd running there? It serves other computers with -G"
            ) from error
        link.write(WATCH)
        return link

    # What follows runs in the receiver's own thread.

    def _follow(self, robot: str, link: ByteLink) -> None:
        port = self._options.robots[robot]
        while not self._stopping.is_set():
            try:
                _Followed(robot, port, self, self._options, self._around).read(link)
            except Exception as error:  # a thread that ends without a word leaves its robot in the dark
                self.note(robot, f"the receiver went away ({error})")
            finally:
                link.close()
            while not self._stopping.wait(AGAIN_S):
                with contextlib.suppress(Exception):
                    link = self._open(robot, port)
                    break
        link.close()

    def note(self, robot: str, why: str) -> None:
        """Say why a robot has no position, once for each reason; an empty one says that it has."""
        if why == self.absent.get(robot, ""):
            return
        if why:
            logger.warning("GNSS of %s: no position: %s", robot, why)
            self.absent[robot] = why
        elif self.absent.pop(robot, ""):
            logger.info("GNSS of %s: has a position again", robot)

    @property
    def stopping(self) -> threading.Event:
        return self._stopping

    def put(self, pose: Pose) -> None:
        """Hand a pose over; where there is no room the robot is absent."""
        if not self._queue.put(pose):
            self.note(pose.robot, "positions come faster than they are taken")


class _Followed:
    """One receiver on one link, until it is gone."""

    def __init__(
        self, robot: str, port: str, source: GnssSource, options: GnssOptions, around: DriverContext
    ) -> None:
        self._robot, self._source, self._around = robot, source, around
        self._port, self._baud = port, options.baud
        device = port.removeprefix("gpsd://").partition("/")[2]
        is_gpsd = port.startswith("gpsd://")
        self._reader: NmeaReader | GpsdReader = (
            GpsdReader(f"/{device}" if device else "") if is_gpsd else NmeaReader()
        )
        self._judge = FixJudge(options.max_speed_m_s, options.worst_sigma_m)
        self._stamps = DeviceStamps()
        self._heading_deg = 0.0

    def read(self, link: ByteLink) -> None:
        """Raises `OSError` and what pyserial raises when the link is gone."""
        heard_s = time.monotonic()
        sentences = 0
        while not self._source.stopping.is_set():
            data = link.read()
            now_s = time.monotonic()
            at_s = self._around.clock.elapsed_s()  # speeds and ages are of mission time
            for fix in self._reader.feed(data, at_s) if data else ():
                self._take(fix, at_s, arrival_ns(link, self._around.clock))
            if self._reader.sentences != sentences:
                sentences, heard_s = self._reader.sentences, now_s
            elif now_s - heard_s > NO_SENTENCE_S:
                came = "nothing but damaged sentences" if self._reader.damaged else "nothing"
                why = f"{came} came for {NO_SENTENCE_S:g} s; {_remedy(self._port, self._baud)}"
                self._source.note(self._robot, why)

    def _take(self, fix: Fix, now_s: float, t_ns: int) -> None:
        why = self._judge.doubt(fix, now_s)
        self._source.note(self._robot, why)
        if why:
            return
        if fix.course_deg is not None and (fix.speed_m_s or 0.0) > NO_HEADING_M_S:
            self._heading_deg = fix.course_deg % 360.0
        east_m, north_m, up_m = self._around.frame.to_local(fix.lat_deg, fix.lon_deg, fix.alt_m)
        if not math.isfinite(east_m + north_m + up_m):
            return
        # By the satellites' time: what a slow link has held back still has its own moment.
        stamp_ns = self._stamps.of(None if fix.time_s is None else round(fix.time_s * 1e9), t_ns)
        self._source.put(
            Pose(stamp_ns, self._robot, east_m, north_m, up_m, self._heading_deg, fix.sigma_m or 0.0, "gnss")
        )


def _remedy(port: str, baud: int) -> str:
    """What to look at where no sentence comes."""
    scheme, separator, _ = port.partition("://")
    if scheme == "gpsd":
        return "has gpsd a receiver that is plugged in?"
    if scheme in ("udp", "tcp"):
        return "does it send to an address of this computer, and to this port?"
    if separator:
        return "does it send NMEA?"
    device, own_baud = device_and_baud(port)
    return f"does it send NMEA at {own_baud or baud} baud? {device}:4800 would name another rate"
