"""A mission is rehearsed with vehicles that are not ours to emulate: their radios hear from where they are."""

import asyncio
import math
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from benches import FRAME, around, free_udp_port, rovers_on_udp, until
from typer.testing import CliRunner

from drivers.cli import emulate
from drivers.emulators.rehearsal import Radios, named_sources, read_rehearsal, wire_for
from drivers.mavlink.fleet import open_link
from drivers.xbee.receiver import open_receiver
from fieldkit.clock import ScaledClock
from fieldkit.errors import ConfigError
from fieldkit.messages import RssReading, Waypoint

MISSION = """\
schema = 1
name = "rehearsed"
[field]
origin_lat_deg = {lat}
origin_lon_deg = {lon}
size_east_m = 60.0
size_north_m = 60.0
[antenna]
file = "antenna.toml"
[sources]
power_levels_db = [0.0]
rate_hz = 5.0
{robots}
"""
ROBOT = """\
[[robot]]
name = "{name}"
receiver = {{ driver = "{driver}", port = "{port}" }}
vehicle = {{ driver = "mavlink", address = "udpin:127.0.0.1:1", system_id = {system_id} }}
"""


def mission_file(folder: Path, *robots: dict[str, object]) -> Path:
    from fieldkit.channel.antenna_file import AntennaFile, dump_antenna
    from fieldkit.channel.model import Antenna

    antenna = Antenna(path_loss_exponent=2.0, power_at_1m_dbm=-40.0, sigma_db=0.5, threshold_dbm=-90.0)
    (folder / "antenna.toml").write_text(dump_antenna(AntennaFile(antenna)))
    tables = [
        ROBOT.format(**({"name": "ada", "driver": "xbee", "port": folder / "ada", "system_id": 1} | each))
        for each in robots or ({},)
    ]
    path = folder / "mission.toml"
    path.write_text(
        MISSION.format(lat=FRAME.origin_lat_deg, lon=FRAME.origin_lon_deg, robots="\n".join(tables))
    )
    return path


@asynccontextmanager
async def rehearsing(folder: Path):
    """One vehicle, its mission's link which forwards telemetry, and its radio; what the radio has heard."""
    clock, port, copy = ScaledClock(5.0), free_udp_port(), free_udp_port()
    what = read_rehearsal(mission_file(folder), sources=named_sources(["40,0"], 20.0))
    options = {"ada": {"system_id": 1, "forward": f"127.0.0.1:{copy}"}}
    heard: list[RssReading] = []
    async with (
        rovers_on_udp({1: (0.0, 0.0)}, clock, port) as rovers,
        Radios(what, f"udpin:127.0.0.1:{copy}", clock, 1) as radios,
        open_link(f"udpin:127.0.0.1:{port}", options, around(clock)) as link,
        open_receiver("ada", {"port": str(folder / "ada")}, around(clock)) as receiver,
    ):

        async def listen() -> None:
            async for item in receiver.readings():
                if isinstance(item, RssReading):
                    heard.append(item)

        async def beat() -> None:
            while True:
                link.beat()
                await clock.sleep(1.0)

        tasks = [asyncio.create_task(listen()), asyncio.create_task(beat())]
        try:
            yield link, rovers[0], radios, heard
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.wait(tasks)


async def test_a_radio_hears_from_where_its_vehicle_is(tmp_path: Path) -> None:
    async with rehearsing(tmp_path) as (link, rover, _, heard):
        await until(lambda: len(heard) > 10)
        far_dbm = sum(each.rss_dbm for each in heard[:10]) / 10
        assert far_dbm == pytest.approx(-40.0 - 20.0 * math.log10(40.0), abs=1.5)
        await link.acquire_control("ada")
        await link.goto("ada", Waypoint(30.0, 0.0, 1.0))
        await until(lambda: rover.autopilot.body.east_m > 29.0, 30.0)
        count = len(heard)
        await until(lambda: len(heard) > count + 10)
        near_dbm = sum(each.rss_dbm for each in heard[-5:]) / 5
        assert near_dbm == pytest.approx(-40.0 - 20.0 * math.log10(10.5), abs=1.5)


async def test_a_radio_whose_vehicle_is_not_heard_hears_nothing(tmp_path: Path) -> None:
    async with rehearsing(tmp_path) as (_, rover, radios, heard):
        await until(lambda: len(heard) > 3)
        rover.silenced = True
        await until(lambda: radios.positions.of(1) is None)
        await asyncio.sleep(0.2)
        count = len(heard)
        await asyncio.sleep(1.0)
        assert len(heard) == count


@pytest.mark.parametrize(
    ("robot", "words"),
    [
        ({"port": "/dev/ttyUSB0"}, "real radio's name"),
        ({"port": "socket://10.0.0.1:7001"}, "on this computer"),
    ],
)
def test_a_real_radios_port_is_not_taken(robot: dict[str, str], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        wire_for(robot["port"], "ada")


def test_a_file_in_the_way_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "notes").write_text("mine")
    with pytest.raises(ConfigError, match="a file of that name"):
        wire_for(str(tmp_path / "notes"), "ada")
    assert (tmp_path / "notes").read_text() == "mine"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is it a mission file"),
        ("[field", "Expected"),
        ('[field]\norigin_lat_deg = "north"', "is it a mission file"),
    ],
)
def test_what_is_no_mission_file_is_named(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "mission.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=words):
        read_rehearsal(path)
    with pytest.raises(ConfigError):
        read_rehearsal(tmp_path / "absent.toml")


def test_other_radios_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="not emulated here"):
        read_rehearsal(mission_file(tmp_path, {"driver": "nrf-sniffer"}))


@pytest.mark.parametrize("text", ["1", "1,2,3,4", "a,b", "nan,1"])
def test_a_transmitter_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="--source"):
        named_sources([text], 0.2)


def test_hidden_ones_are_the_same_with_the_same_seed(tmp_path: Path) -> None:
    path = mission_file(tmp_path)
    assert read_rehearsal(path, seed=4).sources == read_rehearsal(path, seed=4).sources
    assert len(read_rehearsal(path, count=5).sources) == 5
    assert all(0 <= source.east_m <= 60 for source in read_rehearsal(path).sources)


def test_a_copy_goes_nowhere_that_is_no_address() -> None:
    with pytest.raises(ConfigError, match="forward"):
        open_link("udpin:127.0.0.1:1", {"ada": {"system_id": 1, "forward": "there"}}, around())


def test_the_command_says_how(tmp_path: Path) -> None:
    result = CliRunner().invoke(emulate, ["radios", "--help"])
    assert result.exit_code == 0 and "fieldkit emulate radios" in " ".join(result.output.split())
