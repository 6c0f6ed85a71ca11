"""An overhead camera as a `PositionSource`: watches the camera's process, and starts it again when it must."""

import asyncio
import contextlib
import logging
import math
import multiprocessing
import threading
import time
from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from drivers.bounded_queue import BoundedQueue
from drivers.camera.capture import Ended, Found, Task, run
from drivers.camera.file import read_view
from drivers.camera.seen import Body
from drivers.options import REMEDY, checked
from fieldkit import settings as given
from fieldkit.errors import ConfigError, DeviceError
from fieldkit.messages import Pose
from fieldkit.ports import DriverContext

logger = logging.getLogger(__name__)

FIRST_PICTURE_S = 20.0
"""Wall time for the process to start, load OpenCV, connect and show its first picture."""
SILENT_S = 5.0
"""Wall time without a picture after which the process is killed and started again."""
AGAIN_S = 1.0


@dataclass(frozen=True, slots=True)
class CameraOptions:
    """What a mission file says of a camera."""

    source: str = field(metadata={REMEDY: 'write which camera, as in source = "0", or the path of a film'})
    """`rtsp://...` or another URL, a USB camera's number or path, or a video file."""
    calibration: str = field(
        metadata={
            REMEDY: 'write the file that "fieldkit camera calibrate" made, as in calibration = "camera.toml"'
        }
    )
    """Path of the calibration file: see `file`."""
    robots: dict[str, Any] = field(default_factory=dict)
    """Robot to its mark: `{ marker = 7 }` or `{ front = "red", rear = "blue" }`, and perhaps `mark_m`,
    `height_m`, `front_deg`."""
    family: str = given.MARKERS
    max_speed_m_s: float = given.SEEN_SPEED_M_S
    every_picture: bool = False
    """Of a file: take every picture as fast as possible; poses carry times from the moment of opening."""


def open_camera(options: Mapping[str, Any], around: DriverContext) -> "CameraSource":
    """A camera as a position source, not opened yet. Raises `ConfigError`, `CalibrationRefused`."""
    chosen = checked(CameraOptions, options, "positions (camera)")
    return CameraSource(make_task(chosen), around)


def make_task(options: CameraOptions) -> Task:
    """The camera's process's task, from checked options. Raises `ConfigError`, `CalibrationRefused`."""
    from drivers.camera.markers import FAMILIES

    where = "positions (camera)"
    if options.family not in FAMILIES:
        raise ConfigError(f"{where}: family: expected one of {', '.join(FAMILIES)}, got {options.family!r}")
    if not options.robots:
        raise ConfigError(f"{where}: robots: expected a robot with its marker or patches, got none")
    markers: dict[int, str] = {}
    pairs: dict[str, tuple[str, str]] = {}
    bodies: dict[str, Body] = {}
    for robot, table in options.robots.items():
        mark = dict(table) if isinstance(table, Mapping) else {"marker": table}
        here = f"{where}: robots.{robot}"
        number, front, rear = mark.pop("marker", None), mark.pop("front", None), mark.pop("rear", None)
        if isinstance(number, int) and not isinstance(number, bool) and front is None and rear is None:
            if number in markers:
                raise ConfigError(f"{here}: marker {number} is robot {markers[number]!r}'s already")
            markers[number] = robot
        elif number is None and isinstance(front, str) and isinstance(rear, str) and front != rear:
            if (front, rear) in pairs.values():
                raise ConfigError(f"{here}: another robot has {front} ahead and {rear} behind already")
            pairs[robot] = (front, rear)
        else:
            raise ConfigError(f"{here}: expected marker = number, or front and rear colours, got {table!r}")
        bodies[robot] = checked(Body, mark, here)
    view = read_view(Path(options.calibration))
    if view.camera_m is None and any(body.height_m for body in bodies.values()):
        raise ConfigError(
            f"{where}: height_m needs the camera's place: add camera_m to {options.calibration}"
        )
    return Task(
        options.source,
        view,
        bodies,
        markers,
        options.family,
        pairs,
        options.max_speed_m_s,
        options.every_picture,
    )


class CameraSource:
    """Entering starts the camera's process and waits for the first picture."""

    def __init__(self, task: Task, around: DriverContext) -> None:
        self.robots = tuple(task.bodies)
        self.restarts = 0
        """How often the camera's process had to be started again."""
        self.pictures = 0
        self.inconsistent: dict[str, str] = {}
        """Robot to why it was not believed in the last picture."""
        self._task = task
        self._clock = around.clock
        self._name = f"camera {task.source}"
        self._process: Any = None

    async def __aenter__(self) -> Self:
        self._queue: BoundedQueue[Pose] = BoundedQueue()
        self._stopping = threading.Event()
        self._first = threading.Event()
        self._why = ""
        self._thread = threading.Thread(target=self._watch, name=self._name, daemon=True)
        self._began_ns = self._clock.now_ns()
        self._thread.start()
        try:
            deadline_s = time.monotonic() + FIRST_PICTURE_S
            while not self._first.is_set():
                await asyncio.sleep(0.02)
                if self._why or time.monotonic() > deadline_s:
                    raise DeviceError(
                        f"{self._name}: {self._why or 'no picture came'}; expected a video file, a USB camera's "
                        "number, or a URL that a video player can show"
                    )
        except BaseException:
            await self.__aexit__(None, None, None)
            raise
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stopping.set()
        await asyncio.to_thread(self._thread.join)
        self._queue.close()

    async def poses(self) -> AsyncIterator[Pose]:
        """Poses in the field frame, in order of the pictures. Ends when closed, or with the film."""
        async for pose in self._queue.items():
            yield pose

    # What follows runs in the watching thread.

    def _watch(self) -> None:
        while not self._stopping.is_set():
            ended = self._one_process()
            if ended.over:
                logger.info("%s: %s", self._name, ended.reason)
                return self._queue.close_soon()
            if not self._first.is_set():
                self._why = ended.reason
                return None
            if not self._stopping.wait(AGAIN_S):
                self.restarts += 1
                logger.warning("%s: %s; starting it again", self._name, ended.reason)
        return None

    def _one_process(self) -> Ended:
        """Start the camera's process and pass on what it finds, until it ends or must be killed."""
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe(duplex=False)
        process = self._process = context.Process(target=run, args=(self._task, theirs), daemon=True)
        process.start()
        theirs.close()
        try:
            return self._pass_on(ours)
        finally:
            process.kill()
            process.join()
            ours.close()

    def _pass_on(self, connection: Any) -> Ended:
        heard_s, limit_s = time.monotonic(), FIRST_PICTURE_S
        while not self._stopping.is_set():
            if not connection.poll(0.1):
                if time.monotonic() - heard_s > limit_s:
                    return Ended(f"no picture for {limit_s:g} s")
                continue
            try:
                message = connection.recv()
            except (EOFError, OSError):
                return Ended("the camera's process has died")
            if isinstance(message, Ended):
                return message
            heard_s, limit_s = time.monotonic(), SILENT_S
            self._take(message)
        return Ended("closed")

    def _take(self, found: Found) -> None:
        self.pictures += 1
        self.inconsistent = found.inconsistent
        t_ns = self._mission_time(found.taken_s)
        for fix in found.fixes:
            self._queue.put(
                Pose(t_ns, fix.robot, fix.east_m, fix.north_m, 0.0, fix.heading_deg, fix.sigma_m, "camera")
            )
        self._first.set()

    def _mission_time(self, taken_s: float) -> int:
        if self._task.every_picture:
            return self._began_ns + round(taken_s * 1e9)
        now_ns, late_s = self._clock.now_ns(), time.monotonic() - taken_s
        return now_ns - round(late_s * self._clock.rate * 1e9) if math.isfinite(self._clock.rate) else now_ns

    def kill_process(self) -> None:
        """Kill the camera's process, as a hanging driver would have to be; it is started again."""
        with contextlib.suppress(AttributeError, ValueError):
            self._process.kill()
