"""A person who walks by advice with a radio that prints and a satellite receiver, each on a wire of its own.

A thread with its own loop, on the mission's scaled clock. What the person is advised is read from the link: a real
person reads it from the page.
"""

import asyncio
import tempfile
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from drivers.emulators.gnss import WORTH_M, Seen, nmea
from drivers.emulators.printer import PrintingRadio
from drivers.emulators.wires import PluggedModule, PtyWire
from drivers.emulators.xbee import PROFILES, Module
from fieldkit.channel.model import Antenna
from fieldkit.clock import ScaledClock
from fieldkit.errors import DeviceError
from fieldkit.geo import FieldFrame
from fieldkit.world.channel import sample_rss_dbm
from fieldkit.world.sources import TransientSource, Transmissions
from fieldkit.world.walker import IGNORES, WALKING_M_S, Walker, WanderingError, body_loss_db

STEP_S = 0.2
FIX_S = 1.0
START_S = 10.0


@dataclass(frozen=True, slots=True)
class WalkSpec:
    """What to emulate."""

    clock: ScaledClock
    frame: FieldFrame
    antenna: Antenna
    sources: tuple[TransientSource, ...]
    start_m: tuple[float, float]
    size_m: tuple[float, float]
    style: str
    """In whose words the radio prints; `xbee` is a module that does not print."""
    seed: int
    speed_m_s: float = WALKING_M_S
    ignores: float = IGNORES
    behind_db: float = 8.0
    gnss_sigma_m: float = 3.0
    altitude_m: float = 430.0
    """Of the field above the sea, as the satellite receiver says it: few people search on a beach."""


def emulate(advice: Callable[[], tuple[float, float] | None], **spec: Any) -> "EmulatedWalk":
    """For callers that find it by name; what the keywords are is said at `WalkSpec`."""
    return EmulatedWalk(WalkSpec(**spec), advice)


class EmulatedWalk:
    """Use with `with`. `radio_port` and `gnss_port` are there once it is entered."""

    def __init__(self, spec: WalkSpec, advice: Callable[[], tuple[float, float] | None]) -> None:
        self.radio_port = self.gnss_port = ""
        self._spec, self._advice = spec, advice
        self._ready, self._stopping = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="emulated walk", daemon=True)
        rng = [np.random.default_rng([spec.seed, 0x3A1C, k]) for k in range(4)]
        self._walker = Walker(*spec.start_m, rng[0], spec.speed_m_s, spec.ignores, spec.size_m)
        self._error = WanderingError(spec.gnss_sigma_m, 60.0, rng[1])
        self._traffic, self._channel = Transmissions(list(spec.sources), rng[2]), rng[3]

    @property
    def place_m(self) -> tuple[float, float]:
        """Where the person really is."""
        return self._walker.east_m, self._walker.north_m

    def __enter__(self) -> Self:
        self._thread.start()
        if not self._ready.wait(START_S):
            raise DeviceError("the emulated walk does not start")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stopping.set()
        self._thread.join(START_S)

    def _run(self) -> None:
        asyncio.run(self._walk())

    async def _walk(self) -> None:
        spec = self._spec
        with tempfile.TemporaryDirectory(prefix="fieldkit-") as folder:
            radio = PluggedModule(self._device(), PtyWire(Path(folder) / "radio"))
            await radio.plug()
            gnss = PtyWire(Path(folder) / "gnss")
            await gnss.open(lambda data: None)
            self.radio_port, self.gnss_port = radio.wire.port, gnss.port
            self._ready.set()
            at_s, fixed_s = spec.clock.elapsed_s(), -FIX_S
            while not self._stopping.is_set():
                await asyncio.sleep(max(STEP_S / spec.clock.rate, 0.002))
                now_s = spec.clock.elapsed_s()
                while at_s + STEP_S <= now_s:
                    at_s += STEP_S
                    self._step(radio, at_s)
                if at_s - fixed_s >= FIX_S:
                    fixed_s = at_s
                    gnss.write(nmea(self._seen(), spec.frame))
            radio.unplug()
            gnss.close()

    def _device(self) -> PrintingRadio | Module:
        if self._spec.style == "xbee":
            # Hearing is the channel's business (the antenna's threshold), not a second threshold's.
            return Module(replace(PROFILES["s2c"], sensitivity_dbm=-254.0))
        return PrintingRadio(lambda: self._spec.clock.now_ns() // 1_000, self._spec.style)

    def _step(self, radio: PluggedModule[Any], at_s: float) -> None:
        spec, walker = self._spec, self._walker
        walker.advise(self._advice())
        walker.step(STEP_S)
        self._error.step(STEP_S)
        here = np.array([[walker.east_m, walker.north_m]])
        for _, source in self._traffic.until(at_s):
            way = np.array([[source.east_m, source.north_m]]) - here
            off_deg = np.degrees(np.arctan2(way[:, 0], way[:, 1])) - walker.heading_deg
            lost_db = body_loss_db(off_deg, spec.behind_db)
            rss = sample_rss_dbm(
                spec.antenna, np.hypot(*way.T), source.power_db - lost_db, self._channel, off_deg
            )
            if not np.isnan(rss[0]):
                radio.hear(float(rss[0]), 0x00BEEF, b"")

    def _seen(self) -> Seen:
        spec, walker = self._spec, self._walker
        east, north = (
            walker.east_m + float(self._error.off_m[0]),
            walker.north_m + float(self._error.off_m[1]),
        )
        return Seen(
            spec.clock.now_ns(),
            east,
            north,
            spec.altitude_m,
            walker.speed_m_s,
            walker.heading_deg,
            hdop=spec.gnss_sigma_m / WORTH_M,
        )
