"""Benches for the conformance suites: each driver on its emulator, and each in-process stand-in.

To add a driver, write a bench and put it into the table at the end.
"""

import asyncio
import contextlib
import tempfile
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import numpy as np

from drivers.camera.source import open_camera
from drivers.emulators.autopilot import Autopilot
from drivers.emulators.camera import PictureServer, Scene, Shown, still, write_calibration
from drivers.emulators.capture import PipeSniffer
from drivers.emulators.printer import PrintingRadio
from drivers.emulators.profiles import ROVER, Profile
from drivers.emulators.rover import make_autopilot
from drivers.emulators.sniffers import NrfDongle, TiDongle
from drivers.emulators.wires import Device, PluggedModule, PtyWire, TcpWire, Wire
from drivers.emulators.xbee import Module
from drivers.lines.receiver import open_receiver as open_lines
from drivers.mavlink.fleet import open_link
from drivers.positions.source import open_file
from drivers.sniffers.pcap import open_capture
from drivers.sniffers.receiver import open_nrf, open_ti
from drivers.xbee.receiver import open_receiver, open_survey
from fieldkit.clock import Clock, RealClock, ScaledClock
from fieldkit.geo import FieldFrame
from fieldkit.ports import DriverContext, ReceiverFactory
from fieldkit.testing import PositionSourceBench, ReceiverBench, VehicleLinkBench
from fieldkit.world.bodies import Car
from mission.shell.setups import free_udp_port as free_udp_port  # for the tests of drivers too

FRAME = FieldFrame(47.3977, 8.5456, 400.0)


def around(clock: Clock | None = None) -> DriverContext:
    return DriverContext(clock or RealClock(), FRAME)


Bench = Callable[[], contextlib.AbstractAsyncContextManager[ReceiverBench]]


def on_wire(
    open_it: ReceiverFactory,
    make_device: Callable[[], Device],
    make_wire: Callable[[Path], Wire],
    gap_s: float = 0.0,
    **options: Any,
) -> Bench:
    """A radio driver on an emulated device that hears a packet every `gap_s`."""

    @asynccontextmanager
    async def bench() -> AsyncIterator[ReceiverBench]:
        folder = tempfile.TemporaryDirectory()
        radio = PluggedModule(make_device(), make_wire(Path(folder.name)))
        await radio.plug()

        async def transmit(count: int) -> None:
            for number in range(count):
                # A server may not have taken the connection yet of a driver that asks nothing as it opens.
                async with asyncio.timeout(5.0):
                    while not radio.hear(-60.0 - number, 0x0013A20041000001, b"beacon"):  # noqa: ASYNC110
                        await asyncio.sleep(0.005)
                await asyncio.sleep(gap_s)

        async def unplug() -> None:
            radio.unplug()

        try:
            receiver = open_it("ada", {"port": radio.wire.port, **options}, around())
            yield ReceiverBench(receiver, transmit, unplug, radio.plug)
        finally:
            radio.unplug()
            folder.cleanup()

    return bench


@asynccontextmanager
async def survey_on_wire() -> AsyncIterator[ReceiverBench]:
    """Energy scans back to back: readings come of themselves, 16 channels a scan."""
    folder = tempfile.TemporaryDirectory()
    radio = PluggedModule(Module(), pty(Path(folder.name)))
    await radio.plug()

    async def wait(count: int) -> None:
        await asyncio.sleep(0)

    async def unplug() -> None:
        radio.unplug()

    try:
        receiver = open_survey("ada", {"port": radio.wire.port, "energy_scan_s": 0.05}, around())
        yield ReceiverBench(receiver, wait, unplug, radio.plug, of_itself=True)
    finally:
        radio.unplug()
        folder.cleanup()


@asynccontextmanager
async def capture_on_pipe() -> AsyncIterator[ReceiverBench]:
    """A capture that grows in a named pipe."""
    with tempfile.TemporaryDirectory() as folder:
        sniffer = PipeSniffer(Path(folder) / "live.pcap", RealClock().now_ns)
        await sniffer.plug()

        async def transmit(count: int) -> None:
            for number in range(count):
                assert sniffer.hear(-60.0 - number, 0x1234, b"beacon", short_address=True)

        async def unplug() -> None:
            sniffer.unplug()

        try:
            yield ReceiverBench(
                open_capture("ada", {"port": sniffer.port}, around()), transmit, unplug, sniffer.plug
            )
        finally:
            sniffer.unplug()


@asynccontextmanager
async def camera_on_network() -> AsyncIterator[PositionSourceBench]:
    """A camera driver on an emulated network camera."""
    robots = {"ada": Shown(still(3.0, 4.0, 30.0), marker=3), "bob": Shown(still(7.0, 6.0, 200.0), marker=7)}
    scene = Scene(robots, noise=2.0, shadows=False)
    picture = scene.picture(0.0)
    with tempfile.TemporaryDirectory() as folder:
        calibration = Path(folder) / "camera.toml"
        write_calibration(scene, calibration)
        async with PictureServer(lambda _: picture, rate_hz=8.0) as server:
            options = {
                "source": server.url,
                "calibration": str(calibration),
                "robots": {"ada": {"marker": 3, "mark_m": 0.4}, "bob": {"marker": 7, "mark_m": 0.4}},
            }
            yield PositionSourceBench(open_camera(options, around()), server.unplug, server.plug)


@asynccontextmanager
async def positions_from_file() -> AsyncIterator[PositionSourceBench]:
    """A CSV log of two robots, played fast."""
    with tempfile.TemporaryDirectory() as folder:
        rows = "".join(
            f"{k * 0.05},{name},{k * 0.1},{k * 0.2},90\n" for k in range(200) for name in ("ada", "bob")
        )
        path = Path(folder) / "walk.csv"
        path.write_text("time_s,robot,east_m,north_m,heading_deg\n" + rows)
        yield PositionSourceBench(open_file({"path": str(path)}, around(ScaledClock(5.0))))


async def until(condition: Callable[[], object], timeout_s: float = 30.0) -> None:
    """Wait until `condition` holds; `AssertionError` if it does not within `timeout_s` of wall time."""
    for _ in range(int(timeout_s / 0.005)):
        if condition():
            return
        await asyncio.sleep(0.005)
    raise AssertionError(f"did not happen within {timeout_s:g} s")


class RoverOnUdp(asyncio.DatagramProtocol):
    """An emulated rover on a socket of its own, stepped by a task, in the test's loop."""

    def __init__(self, autopilot: Autopilot, clock: ScaledClock) -> None:
        self.autopilot = autopilot
        self.clock = clock
        self.silenced = False
        self.drop_in: Callable[[bytes], bool] = lambda _: False
        """Says which incoming datagrams are lost."""
        self.got: list[bytes] = []
        """Datagrams that arrived, lost ones too."""

    def t_s(self) -> float:
        return (self.clock.now_ns() - self.clock.start_ns) * 1e-9

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = transport

    def datagram_received(self, data: bytes, address: object) -> None:
        self.got.append(data)
        if not self.silenced and not self.drop_in(data):
            self.send(self.autopilot.receive(data, self.t_s()))

    def error_received(self, error: Exception) -> None:
        pass

    def send(self, data: bytes) -> None:
        if data and not self.silenced:
            self.transport.sendto(data)  # type: ignore[attr-defined]

    async def live(self) -> None:
        while True:
            self.send(self.autopilot.update(self.t_s()))
            await self.clock.sleep(0.05)


@asynccontextmanager
async def rovers_on_udp(
    starts_m: dict[int, tuple[float, float]],
    clock: ScaledClock,
    port: int,
    profile: Profile = ROVER,
    **options: Any,
) -> AsyncIterator[list[RoverOnUdp]]:
    """Emulated vehicles by system id, sending to a local port."""
    loop, rovers, tasks = asyncio.get_running_loop(), [], []
    for system_id, (east_m, north_m) in starts_m.items():
        body, rng = Car(east_m, north_m, max_speed_m_s=1.0), np.random.default_rng(system_id)
        autopilot = make_autopilot(profile, system_id, body, FRAME, rng, **options)
        rover = RoverOnUdp(autopilot, clock)
        await loop.create_datagram_endpoint(lambda rover=rover: rover, remote_addr=("127.0.0.1", port))
        rovers.append(rover)
        tasks.append(asyncio.create_task(rover.live()))
    try:
        yield rovers
    finally:
        for task, rover in zip(tasks, rovers, strict=True):
            task.cancel()
            rover.transport.close()
        await asyncio.wait(tasks)


@asynccontextmanager
async def mavlink_on_rovers() -> AsyncIterator[VehicleLinkBench]:
    clock, port = ScaledClock(10.0), free_udp_port()
    starts_m = {3: (1.0, 1.0), 4: (5.0, 1.0)}
    async with rovers_on_udp(starts_m, clock, port, gcs_failsafe_s=20.0):
        robots = {"ada": {"system_id": 3}, "bob": {"system_id": 4}}
        link = open_link(f"udpin:127.0.0.1:{port}", robots, around(clock))
        yield VehicleLinkBench(link, clock, {"ada": starts_m[3], "bob": starts_m[4]})


def pty(folder: Path) -> Wire:
    return PtyWire(folder / "radio")


def tcp(_: Path) -> Wire:
    return TcpWire()


def now_us() -> int:
    return RealClock().now_ns() // 1000


RECEIVERS: dict[str, Bench] = {
    "xbee-pty": on_wire(open_receiver, Module, pty),
    "xbee-tcp": on_wire(open_receiver, Module, tcp),
    "xbee-asking-db": on_wire(open_receiver, lambda: Module(settings={"AO": 0}), pty, 1.5, ask_db=True),
    "nrf-sniffer": on_wire(open_nrf, lambda: NrfDongle(now_us), pty),
    "ti-sniffer": on_wire(open_ti, lambda: TiDongle(now_us), pty),
    "pcap": capture_on_pipe,
    "lines-pty": on_wire(open_lines, lambda: PrintingRadio(now_us, "rylr"), pty, map="rylr"),
    "lines-tcp": on_wire(open_lines, lambda: PrintingRadio(now_us, "meshtastic"), tcp, map="meshtastic"),
    "ed": survey_on_wire,
}
VEHICLE_LINKS = {"mavlink": mavlink_on_rovers}
POSITION_SOURCES: dict[str, Any] = {"camera": camera_on_network, "file": positions_from_file}
