"""Emulated devices run from the command line until Ctrl-C: says where to connect, then keeps quiet."""

import asyncio
import contextlib
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import typer

from drivers.emulators.capture import PipeSniffer
from drivers.emulators.claims import claimed_vehicles
from drivers.emulators.defaults import HIDDEN_HZ
from drivers.emulators.field import EmulatedRobot, FieldSpec, start
from drivers.emulators.printer import PrintingRadio
from drivers.emulators.sniffers import NrfDongle, TiDongle
from drivers.emulators.wires import PluggedModule, TcpWire, make_wire
from drivers.emulators.xbee import Module, Profile
from fieldkit import plugins
from fieldkit.channel.antenna_file import AntennaFile, dump_antenna
from fieldkit.channel.model import Antenna
from fieldkit.clock import RealClock, ScaledClock, wall_sleep
from fieldkit.errors import ConfigError
from fieldkit.files import write_whole
from fieldkit.geo import FieldFrame
from fieldkit.world.sources import TransientSource
from fieldkit.world.surroundings import Surroundings

ANTENNA = Antenna(path_loss_exponent=2.53, power_at_1m_dbm=-62.0, sigma_db=3.3, threshold_dbm=-70.0)
"""An XBee pair with little power near the ground, as that of the example's readings: heard to about 2 m."""


async def run_xbee(
    profile: Profile,
    settings: dict[str, int],
    rate_hz: float,
    rss_dbm: float,
    sigma_db: float,
    tcp_port: int,
    seed: int,
) -> None:
    """One module that hears packets as a Poisson process, in wall time."""
    rng = np.random.default_rng(seed)
    radio = PluggedModule(
        Module(profile, settings=settings), TcpWire(number=tcp_port) if tcp_port else make_wire()
    )
    await radio.plug()
    typer.echo(f'XBee {profile.name}: port = "{radio.wire.port}"   (Ctrl-C ends it)')
    number = 0
    while True:
        await asyncio.sleep(rng.exponential(1.0 / rate_hz))
        strength = round(rng.normal(rss_dbm, sigma_db))
        radio.hear(float(min(strength, -1)), 0x0013A20041000000, number.to_bytes(4, "big"))
        number += 1


async def run_sniffer(
    kind: str, channel: int, rate_hz: float, rss_dbm: float, sigma_db: float, seed: int
) -> None:
    """A dongle on a pty, or a capture in a pipe, that hears packets as a Poisson process, in wall time."""
    rng = np.random.default_rng(seed)
    clock = RealClock()
    with tempfile.TemporaryDirectory(prefix="fieldkit-") as folder:
        radio: PipeSniffer | PluggedModule[Any]
        if kind == "pcap":
            radio = PipeSniffer(Path(folder) / "live.pcap", clock.now_ns, channel)
            port, driver = radio.port, "pcap"
            await radio.plug()
        else:
            dongle = (NrfDongle if kind == "nrf" else TiDongle)(lambda: clock.now_ns() // 1000, channel)
            radio = PluggedModule(dongle, make_wire())
            await radio.plug()
            port, driver = radio.wire.port, f"{kind}-sniffer"
        typer.echo(f'driver = "{driver}", port = "{port}", channel = {channel}   (Ctrl-C ends it)')
        number = 0
        while True:
            await asyncio.sleep(rng.exponential(1.0 / rate_hz))
            strength = float(min(round(rng.normal(rss_dbm, sigma_db)), -1))
            radio.hear(strength, 0x1234, number.to_bytes(4, "big"), short_address=True)
            number += 1


async def run_printer(style: str, rate_hz: float, rss_dbm: float, sigma_db: float, seed: int) -> None:
    """A radio on a pty that prints packets as a Poisson process, in wall time."""
    rng = np.random.default_rng(seed)
    clock = RealClock()
    radio = PluggedModule(PrintingRadio(lambda: clock.now_ns() // 1000, style), make_wire())
    await radio.plug()
    typer.echo(f'driver = "lines", port = "{radio.wire.port}", map = "{style}"   (Ctrl-C ends it)')
    while True:
        await asyncio.sleep(rng.exponential(1.0 / rate_hz))
        radio.hear(float(min(round(rng.normal(rss_dbm, sigma_db)), -1)), 0x1234, b"")


async def run_camera(folder: str, rate_hz: float, port: int) -> None:
    """A network camera that shows four robots, two of them driving."""
    from drivers.camera.benchmark import marker_scene
    from drivers.emulators.camera import PictureServer, write_calibration

    scene = marker_scene()
    calibration = Path(folder) / "camera.toml"
    if calibration.exists():
        raise ConfigError(f"{calibration} exists already; give another folder with --out")
    write_calibration(scene, calibration)
    async with PictureServer(scene.picture, rate_hz, port) as server:
        typer.echo(f'source = "{server.url}", calibration = "{calibration}"')
        for name, shown in scene.robots.items():
            typer.echo(f"{name}: marker {shown.marker}, {shown.mark_m:g} m wide, {shown.height_m:g} m up")
        typer.echo("Ctrl-C ends it")
        await asyncio.Event().wait()


def run_field(
    robots: tuple[EmulatedRobot, ...],
    sources: tuple[TransientSource, ...],
    address: str,
    origin_deg: tuple[float, float],
    max_speed_m_s: float,
    rate: float,
    seed: int,
    size_m: float,
    around: Surroundings,
    write: Callable[[list[tuple[str, int, str, str]]], None] | None = None,
) -> None:
    """A field of robots, until Ctrl-C.

    `write` is given each robot's name, system id, its radio's port and its telemetry's address once they are there.
    """
    frame = FieldFrame(*origin_deg)
    clock = ScaledClock(rate)
    spec = FieldSpec(
        clock,
        frame,
        ANTENNA,
        sources,
        robots,
        address,
        seed,
        pose_noise_m=0.02,
        max_speed_m_s=max_speed_m_s,
        size_m=size_m,
        around=around,
    )
    sends_to: dict[str, list[EmulatedRobot]] = {}
    for robot in robots:
        sends_to.setdefault(robot.address or address, []).append(robot)
    with contextlib.ExitStack() as stack:
        for each, team in sends_to.items():
            stack.enter_context(claimed_vehicles(each, [robot.system_id for robot in team]))
        running = stack.enter_context(start(spec))
        for each, team in sends_to.items():
            who = "rovers send" if len(sends_to) == 1 else f"{team[0].name} sends"
            typer.echo(f'{who} to {each}: vehicle address = "udpin:{each}"')
        for robot in robots:
            port = running.receiver_ports[robot.name]
            typer.echo(f'{robot.name}: system_id = {robot.system_id}, port = "{port}"')
        for number, source in enumerate(sources, start=1):
            typer.echo(
                f"hidden transmitter {number}: {source.east_m:.2f} m east, {source.north_m:.2f} m north"
            )
        if write is not None:
            ports = running.receiver_ports
            write([(r.name, r.system_id, ports[r.name], r.address or address) for r in robots])
        typer.echo("Ctrl-C ends it")
        while True:
            wall_sleep(0.5)


def write_mission(
    out: Path,
    size_m: float,
    sources: int,
    origin_deg: tuple[float, float],
    max_speed_m_s: float,
    agents: bool,
    robots: list[tuple[str, int, str, str]],
) -> None:
    """A mission file and an antenna file in `out` that fit an emulated field, for one computer or for `agents`."""
    text = plugins.load("fieldkit.templates", "emulated")(
        size_m=size_m,
        origin_deg=origin_deg,
        sources=sources,
        rate_hz=HIDDEN_HZ,
        max_speed_m_s=max_speed_m_s,
        robots=robots,
    )
    write_whole(out / "antenna.toml", dump_antenna(AntennaFile(ANTENNA)))
    write_whole(out / "mission.toml", text)
    if not agents:
        typer.echo(f"written: {out}/{{mission.toml, antenna.toml}}, ready to run in another terminal:")
        typer.echo(f"  fieldkit run {out}/mission.toml --page")
        return
    begin, names = f"  fieldkit agent {out}/mission.toml", [name for name, *_ in robots]
    typer.echo(f"written: {out}/{{mission.toml, antenna.toml}}")
    typer.echo("first a key, once:")
    typer.echo(f"{begin} --new-key")
    typer.echo("then the agents, each in a terminal of its own:")
    for name in names:
        typer.echo(f"{begin} --robot {name} --out {name}")
    typer.echo("a laptop that watches, with a page:")
    typer.echo(f"{begin} --watch --out laptop")
    typer.echo("when all have ended, their recordings as one (no laptop: leave it out):")
    typer.echo(f"  fieldkit collect collected.mcap {' '.join(names)} laptop")
