"""Emulated devices run from the command line until Ctrl-C: says where to connect, then keeps quiet."""

import asyncio

import numpy as np
import typer

from drivers.emulators.field import EmulatedRobot, FieldSpec, start
from drivers.emulators.wires import PluggedModule, TcpWire, make_wire
from drivers.emulators.xbee import Module, Profile
from fieldkit.antenna.model import Antenna
from fieldkit.clock import ScaledClock, wall_sleep
from fieldkit.geo import FieldFrame
from fieldkit.world.sources import TransientSource

ANTENNA = Antenna(path_loss_exponent=2.0, power_at_1m_dbm=-50.0, sigma_db=4.0, threshold_dbm=-92.0)
"""An XBee pair near the ground, roughly."""


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


def run_field(
    robots: tuple[EmulatedRobot, ...],
    sources: tuple[TransientSource, ...],
    address: str,
    origin_deg: tuple[float, float],
    max_speed_m_s: float,
    rate: float,
    seed: int,
) -> None:
    """A field of robots, until Ctrl-C."""
    frame = FieldFrame(*origin_deg)
    clock = ScaledClock(rate)
    spec = FieldSpec(
        clock, frame, ANTENNA, sources, robots, address, seed, pose_noise_m=0.02, max_speed_m_s=max_speed_m_s
    )
    with start(spec) as running:
        typer.echo(f'rovers send to {address}: vehicle address = "udpin:{address}"')
        for robot in robots:
            port = running.receiver_ports[robot.name]
            typer.echo(f'{robot.name}: system_id = {robot.system_id}, port = "{port}"')
        for number, source in enumerate(sources, start=1):
            typer.echo(
                f"hidden transmitter {number}: {source.east_m:.2f} m east, {source.north_m:.2f} m north"
            )
        typer.echo("Ctrl-C ends it")
        while True:
            wall_sleep(0.5)
