"""The camera's process: reads pictures, finds robots, sends fixes. It can be killed at any moment.

A network camera's read can hang for ever in the video library, so it lives in a process that is watched from
outside (`source`). Pictures do not cross; what was found does, with the monotonic time of the picture.
"""

import contextlib
import os
import signal
import threading
import time
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from drivers.camera.seen import Body, Fix, Judge
from drivers.camera.view import View
from fieldkit import settings as given

OPEN_TIMEOUT_MS = 5000
READ_TIMEOUT_MS = 3000


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """What the camera's process is to do. Picklable."""

    source: str
    """A file, a device number or path, or a URL."""
    view: View
    bodies: dict[str, Body]
    markers: dict[int, str] = field(default_factory=dict)
    """Marker number to robot."""
    family: str = given.MARKERS
    pairs: dict[str, tuple[str, str]] = field(default_factory=dict)
    """Robot to the colours of its front and rear patch."""
    max_speed_m_s: float = given.SEEN_SPEED_M_S
    every_picture: bool = False
    """Of a file: take all pictures as fast as they come, not at their own pace."""


@dataclass(frozen=True, slots=True)
class Found:
    """The robots in one picture."""

    number: int
    taken_s: float
    """When the picture was there, by `time.monotonic()`; of a file read at once, its time in the film."""
    took_s: float
    """From there to the fixes."""
    fixes: tuple[Fix, ...]
    inconsistent: dict[str, str]


@dataclass(frozen=True, slots=True)
class Ended:
    """No more pictures: the film is over, or why there are none."""

    reason: str
    over: bool = False


class Finder:
    """Pictures in, fixes out: markers, patches, or both."""

    def __init__(self, task: Task) -> None:
        import cv2

        from drivers.camera.markers import MarkerFinder
        from drivers.camera.patches import PatchFinder

        cv2.setNumThreads(1)  # the camera has one core, the mission the others
        self.judge = Judge(task.view, task.bodies, task.max_speed_m_s)
        self._finders: list[Any] = []
        if task.markers:
            self._finders.append(MarkerFinder(task.family, task.markers))
        if task.pairs:
            gaps = {robot: task.bodies[robot].mark_m or 0.2 for robot in task.pairs}
            self._finders.append(PatchFinder(task.pairs, task.view, gaps, self.judge.last_m))

    def fixes(self, picture: Any, t_s: float) -> list[Fix]:
        """The robots in a picture taken at `t_s`, those that are sure."""
        seen = [each for finder in self._finders for each in finder.find(picture)]
        return self.judge.judge(seen, t_s)


def is_file(source: str) -> bool:
    return "://" not in source and not source.isdigit() and not source.startswith("/dev/")


def open_video(source: str) -> Any:
    """An OpenCV capture; not opened where there is nothing."""
    import cv2

    if source.isdigit() or source.startswith("/dev/"):
        video = cv2.VideoCapture(int(source) if source.isdigit() else source)
        video.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        return video
    # RTSP over UDP loses packets on busy WiFi, and every lost one smears the picture.
    os.environ.setdefault("OPENCV_FFMPEG_CAPTURE_OPTIONS", "rtsp_transport;tcp")
    limits = [
        cv2.CAP_PROP_OPEN_TIMEOUT_MSEC,
        OPEN_TIMEOUT_MS,
        cv2.CAP_PROP_READ_TIMEOUT_MSEC,
        READ_TIMEOUT_MS,
    ]
    return cv2.VideoCapture(source, cv2.CAP_FFMPEG, [] if is_file(source) else limits)


def run(task: Task, connection: Connection) -> None:
    """The process's main function."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle
    with contextlib.suppress(BrokenPipeError, ConnectionResetError, EOFError):  # the parent has gone
        _run(task, connection)


def _run(task: Task, connection: Connection) -> None:
    if is_file(task.source) and not Path(task.source).is_file():
        connection.send(Ended(f"no such file: {task.source}"))
        return
    video = open_video(task.source)
    if not video.isOpened():
        connection.send(Ended(f"{task.source} cannot be opened as video"))
        return
    finder = Finder(task)
    pictures = _film(video, task.every_picture) if is_file(task.source) else _live(video)
    number = 0
    for taken_s, picture in pictures:
        began_s = time.monotonic()
        fixes = finder.fixes(picture, taken_s)
        ended_s = time.monotonic()
        took_s = ended_s - (began_s if task.every_picture else taken_s)
        connection.send(Found(number, taken_s, took_s, tuple(fixes), dict(finder.judge.inconsistent)))
        number += 1
    video.release()
    over = is_file(task.source) and number > 0
    connection.send(Ended("the film is over" if over else f"{task.source} gives no pictures", over))


def _film(video: Any, every_picture: bool) -> Any:
    """Pictures of a file, at its pace or as fast as they come. A damaged picture is left out."""
    import cv2

    rate_hz = video.get(cv2.CAP_PROP_FPS)
    period_s = 1.0 / rate_hz if 0.1 < rate_hz < 1000.0 else 0.04
    began_s, number = time.monotonic(), 0
    while True:
        good, picture = video.read()
        if not good:
            return
        due_s = number * period_s
        if not every_picture:
            time.sleep(max(0.0, began_s + due_s - time.monotonic()))
            due_s += began_s
        yield due_s, picture
        number += 1


def _live(video: Any) -> Any:
    """The newest picture each time: what came while we were at work is left out, so nothing falls behind."""
    newest: list[tuple[float, Any]] = []
    there = threading.Condition()
    ended = threading.Event()

    def grab() -> None:
        while True:
            good, picture = video.read()
            taken_s = time.monotonic()
            with there:
                if not good:
                    ended.set()
                else:
                    newest[:] = [(taken_s, picture)]
                there.notify_all()
            if not good:
                return

    threading.Thread(target=grab, name="grab", daemon=True).start()
    while True:
        with there:
            there.wait_for(lambda: newest or ended.is_set())
            if not newest:
                return
            item = newest.pop()
        yield item
