"""A rendered field as an overhead camera shows it: robots with marks, noise, blur, shadows, things in the way.

`Scene.picture(t_s)` is the truth seen through `Eye`, a pinhole camera; `write_film` puts it into an MJPG file and
`PictureServer` serves it as a network camera does (Motion JPEG over HTTP). Needs OpenCV, imported where it is used.
"""

import asyncio
import contextlib
import errno
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from drivers.emulators.defaults import PICTURES_HZ
from fieldkit import settings as given
from fieldkit.messages import FloatArray

SUPERSAMPLE = 3


@dataclass(frozen=True, slots=True)
class Eye:
    """A camera without distortion: where it hangs, where it looks, how it is built."""

    place_m: tuple[float, float, float] = (5.0, 0.5, 9.5)
    """East, north, up: a mast or a window at the height of a third storey."""
    looks_at_m: tuple[float, float] = (5.0, 5.0)
    focal_px: float = 610.0
    width: int = 1280
    height: int = 720

    def project(self, points_m: FloatArray) -> FloatArray:
        """(n, 2) pixels of (n, 3) points."""
        place = np.array(self.place_m)
        ahead = np.array([*self.looks_at_m, 0.0]) - place
        ahead /= np.linalg.norm(ahead)
        across = np.cross(ahead, [0.0, 0.0, 1.0])
        if np.linalg.norm(across) < 1e-6:  # straight down: north is up in the picture
            across = np.array([1.0, 0.0, 0.0])
        across /= np.linalg.norm(across)
        down = np.cross(ahead, across)
        seen = (np.asarray(points_m, dtype=float) - place) @ np.column_stack([across, down, ahead])
        result: FloatArray = seen[:, :2] / seen[:, 2:] * self.focal_px + [
            self.width / 2 - 0.5,
            self.height / 2 - 0.5,
        ]
        return result


Course = Callable[[float], tuple[float, float, float]]
"""Time in seconds to east, north (m) and heading (deg)."""


@dataclass(frozen=True, slots=True)
class Shown:
    """A robot in the picture: a square marker, or a front and a rear patch."""

    path: Course
    marker: int | None = None
    mark_m: float = 0.4
    """A marker's side, or the distance of the patches."""
    height_m: float = 0.0
    front_bgr: tuple[int, int, int] = (0, 0, 220)
    rear_bgr: tuple[int, int, int] = (220, 60, 0)


@dataclass
class Scene:
    """What there is to see. Noise and blur in grey levels and pixels (standard deviations)."""

    robots: dict[str, Shown]
    eye: Eye = field(default_factory=Eye)
    size_m: float = 10.0
    family: str = given.MARKERS
    noise: float = 5.0
    blur_px: float = 0.7
    shadows: bool = True
    hiding_m: Course | None = None
    """Where something a metre wide stands over the field and hides what is under it."""
    seed: int = 1

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(self.seed)
        self._ground = self._make_ground()
        self._noise = self._rng.normal(0.0, self.noise, (self.eye.height * 2, self.eye.width * 2, 3)).astype(
            np.float32
        )

    def ground_points(self, count: int = 4) -> tuple[FloatArray, FloatArray]:
        """Pixels and places of the field's corners, and of `count - 4` points between."""
        s = self.size_m
        places = [(0.0, 0.0), (s, 0.0), (s, s), (0.0, s), (s / 2, 0.0), (s, s / 2), (s / 2, s), (0.0, s / 2)]
        field_m = np.array(places[:count])
        return self.eye.project(np.column_stack([field_m, np.zeros(count)])), field_m

    def picture(self, t_s: float) -> Any:
        """(rows, columns, 3) bytes, BGR."""
        import cv2

        picture = self._ground.copy()
        for shown in self.robots.values():
            self._put(picture, shown, shown.path(t_s))
        if self.shadows:
            self._shade(picture, t_s)
        if self.hiding_m is not None:
            east, north, _ = self.hiding_m(t_s)
            self._fill(picture, _square(east, north, 30.0, 1.0, 0.5), (60, 70, 80))
        if self.blur_px > 0:
            picture = cv2.GaussianBlur(picture, (0, 0), self.blur_px)
        y, x = self._rng.integers(0, (self.eye.height, self.eye.width))
        noise = self._noise[y : y + self.eye.height, x : x + self.eye.width]
        return cv2.add(picture.astype(np.float32), noise).clip(0, 255).astype(np.uint8)

    def _make_ground(self) -> Any:
        """Grey, with coarse grain, and lines a metre apart."""
        import cv2

        coarse = self._rng.normal(0, 6, (self.eye.height // 8, self.eye.width // 8)).astype(np.float32)
        grain = cv2.resize(coarse, (self.eye.width, self.eye.height), interpolation=cv2.INTER_CUBIC)
        ground = np.repeat((120 + grain)[:, :, None], 3, axis=2).clip(0, 255).astype(np.uint8)
        for k in range(int(self.size_m) + 1):
            for ends in ([(k, 0), (k, self.size_m)], [(0, k), (self.size_m, k)]):
                a, b = self.eye.project(np.array([(*end, 0.0) for end in ends]))
                cv2.line(
                    ground,
                    a.round().astype(int).tolist(),
                    b.round().astype(int).tolist(),
                    (145, 145, 145),
                    1,
                    cv2.LINE_AA,
                )
        return ground

    def _put(self, picture: Any, shown: Shown, pose: tuple[float, float, float]) -> None:
        import cv2

        east, north, heading = pose
        side = shown.mark_m
        if shown.marker is not None:
            self._fill(picture, _square(east, north, heading, side * 1.5, shown.height_m), (235, 235, 235))
            from drivers.camera.markers import dictionary

            texture = cv2.aruco.generateImageMarker(dictionary(self.family), shown.marker, 120)
            self._paste(picture, texture, _square(east, north, heading, side, shown.height_m))
            return
        self._fill(picture, _square(east, north, heading, side * 2.2, shown.height_m), (35, 35, 35))
        ahead = np.array([math.sin(math.radians(heading)), math.cos(math.radians(heading))]) * side / 2
        for sign, colour in ((1, shown.front_bgr), (-1, shown.rear_bgr)):
            middle = np.array([east, north]) + sign * ahead
            self._fill(picture, _square(middle[0], middle[1], heading, side * 0.75, shown.height_m), colour)

    def _fill(self, picture: Any, corners_m: FloatArray, colour: tuple[int, int, int]) -> None:
        import cv2

        corners = np.round(self.eye.project(corners_m) * 16).astype(np.int32)
        cv2.fillConvexPoly(picture, corners, colour, cv2.LINE_AA, shift=4)

    def _paste(self, picture: Any, texture: Any, corners_m: FloatArray) -> None:
        """Warp a texture onto the picture, each pixel the mean of several samples."""
        import cv2

        corners = self.eye.project(corners_m)
        low = np.maximum(np.floor(corners.min(axis=0)).astype(int) - 2, 0)
        high = np.minimum(np.ceil(corners.max(axis=0)).astype(int) + 3, [self.eye.width, self.eye.height])
        width, height = high - low
        if width <= 0 or height <= 0:
            return
        size = texture.shape[0]
        # A texture's pixel k covers k to k + 1, and OpenCV names its middle k.
        from_px = np.array([[0, 0], [size, 0], [size, size], [0, size]], dtype=np.float32) - 0.5
        to_px = ((corners - low + 0.5) * SUPERSAMPLE - 0.5).astype(np.float32)
        warp = cv2.getPerspectiveTransform(from_px, to_px)
        shape = (int(width) * SUPERSAMPLE, int(height) * SUPERSAMPLE)
        image = cv2.warpPerspective(
            texture, warp, shape, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        inside = np.zeros((shape[1], shape[0]), np.uint8)
        cv2.fillConvexPoly(inside, np.round(to_px * 16).astype(np.int32), 255, cv2.LINE_AA, shift=4)
        target = (int(width), int(height))
        image = cv2.resize(image, target, interpolation=cv2.INTER_AREA).astype(np.float32)[:, :, None]
        share = cv2.resize(inside, target, interpolation=cv2.INTER_AREA).astype(np.float32)[:, :, None] / 255
        there = picture[low[1] : high[1], low[0] : high[0]]
        there[:] = (there * (1 - share) + image * share).round().astype(np.uint8)

    def _shade(self, picture: Any, t_s: float) -> None:
        """A building's hard shadow over a third of the field, and a cloud's that drifts."""
        import cv2

        shade = np.ones(picture.shape[:2], np.float32)
        edge = self.size_m * 0.35
        for corners in (
            [(-3, -3), (edge, -3), (edge + 1.5, self.size_m + 3), (-3, self.size_m + 3)],
            [(4 + 0.2 * t_s, 6), (7 + 0.2 * t_s, 6), (7 + 0.2 * t_s, 8), (4 + 0.2 * t_s, 8)],
        ):
            points = self.eye.project(np.array([(*corner, 0.0) for corner in corners], dtype=float))
            layer = np.ones(picture.shape[:2], np.float32)
            cv2.fillPoly(layer, [points.round().astype(np.int32)], 0.45, cv2.LINE_AA)
            shade = np.minimum(shade, layer)
        shade = cv2.GaussianBlur(shade, (0, 0), 1.5)
        picture[:] = (picture * shade[:, :, None]).astype(np.uint8)


def circle(
    east_m: float, north_m: float, radius_m: float, speed_m_s: float = 0.4, phase: float = 0.0
) -> Course:
    """Driving round a point, clockwise."""

    def path(t_s: float) -> tuple[float, float, float]:
        angle = phase + speed_m_s * t_s / radius_m
        heading = (math.degrees(angle) + 90.0) % 360.0
        return east_m + radius_m * math.sin(angle), north_m + radius_m * math.cos(angle), heading

    return path


def still(east_m: float, north_m: float, heading_deg: float) -> Course:
    """Standing."""
    return lambda t_s: (east_m, north_m, heading_deg)


def _square(east: float, north: float, heading_deg: float, side_m: float, up_m: float) -> FloatArray:
    """(4, 3): front left, front right, rear right, rear left."""
    angle = math.radians(heading_deg)
    ahead = np.array([math.sin(angle), math.cos(angle)]) * side_m / 2
    right = np.array([math.cos(angle), -math.sin(angle)]) * side_m / 2
    flat = np.array([ahead - right, ahead + right, right - ahead, -ahead - right])
    flat += [east, north]
    return np.column_stack([flat, np.full(4, up_m)])


def write_film(scene: Scene, path: Path, duration_s: float, rate_hz: float = PICTURES_HZ) -> list[float]:
    """Write a Motion JPEG film (.avi); the time of each of its pictures."""
    import cv2

    size = (scene.eye.width, scene.eye.height)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), rate_hz, size)
    times = [number / rate_hz for number in range(round(duration_s * rate_hz))]
    for t_s in times:
        writer.write(scene.picture(t_s))
    writer.release()
    return times


def write_calibration(scene: Scene, path: Path, count: int = 8, click_px: float = 0.5) -> None:
    """The calibration file a user would make by clicking on known points, `click_px` off."""
    pixels, field_m = scene.ground_points(count)
    pixels = pixels + np.random.default_rng(scene.seed).normal(0.0, click_px, pixels.shape)
    rows = "".join(
        f"  [{x:.2f}, {y:.2f}, {e:.2f}, {n:.2f}],\n" for (x, y), (e, n) in zip(pixels, field_m, strict=True)
    )
    path.write_text(
        f"schema = 1\ncamera_m = {list(scene.eye.place_m)}\npoints = [\n{rows}]\n", encoding="utf-8"
    )


class PictureServer:
    """A network camera: Motion JPEG over HTTP. It can stall, send damaged pictures, and go away."""

    def __init__(self, picture: Callable[[float], Any], rate_hz: float = PICTURES_HZ, port: int = 0) -> None:
        self._picture, self._rate_hz, self._port = picture, rate_hz, port
        self._server: asyncio.Server | None = None
        self._tasks: set[asyncio.Task[Any]] = set()
        self.stalled = False
        """Connected and silent."""
        self.rewrite: Callable[[bytes], bytes] | None = None
        """Applied to each picture's bytes: drop, truncate, flip."""
        self.url = ""

    async def __aenter__(self) -> "PictureServer":
        await self.plug()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.unplug()

    async def plug(self) -> None:
        """Come up, under the same address as before."""
        for _ in range(50):
            # A process that is being started holds what was open for a moment after it was closed here.
            with contextlib.suppress(OSError):
                self._server = await asyncio.start_server(self._serve, "127.0.0.1", self._port)
                break
            await asyncio.sleep(0.1)
        else:
            raise OSError(errno.EADDRINUSE, f"port {self._port} is in use")
        self._port = self._server.sockets[0].getsockname()[1]
        self.url = f"http://127.0.0.1:{self._port}/video.mjpg"

    async def unplug(self) -> None:
        """Go away: every connection breaks."""
        if self._server is not None:
            self._server.close()
            self._server = None
        for task in list(self._tasks):
            task.cancel()
        if self._tasks:
            await asyncio.wait(self._tasks)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        import cv2

        task = asyncio.current_task()
        assert task is not None
        self._tasks.add(task)
        loop = asyncio.get_running_loop()
        began_s = loop.time()
        try:
            await reader.readuntil(b"\r\n\r\n")
            writer.write(b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace;boundary=frame\r\n\r\n")
            while True:
                if not self.stalled:
                    picture = await asyncio.to_thread(self._picture, loop.time() - began_s)
                    data = bytes(cv2.imencode(".jpg", picture)[1])
                    data = self.rewrite(data) if self.rewrite else data
                    head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n\r\n"
                    writer.write(head.encode() + data + b"\r\n")
                    await writer.drain()
                await asyncio.sleep(1 / self._rate_hz)
        except (ConnectionError, asyncio.IncompleteReadError, asyncio.CancelledError):
            pass
        finally:
            self._tasks.discard(task)
            writer.transport.abort()
            with contextlib.suppress(ConnectionError):
                await writer.wait_closed()
