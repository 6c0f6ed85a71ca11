"""What is plugged in, and who is heard."""

import asyncio
import json
from types import SimpleNamespace

import pytest
import typer
from benches import free_udp_port, rovers_on_udp
from typer.testing import CliRunner

from drivers import cli, inventory
from drivers.emulators.sniffers import TiDongle
from drivers.emulators.wires import PluggedModule, PtyWire
from fieldkit.clock import ScaledClock


def run(function, *arguments):
    app = typer.Typer()
    app.command()(function)
    return CliRunner().invoke(app, list(arguments))


def test_ports_are_told_by_their_usb_identity(monkeypatch):
    port = SimpleNamespace(device="/dev/ttyACM3", vid=0x1915, pid=0x154B, description="x")
    monkeypatch.setattr(inventory.list_ports, "comports", lambda: [port])
    assert "nrf-sniffer" in run(cli.devices).output


async def test_an_xbee_is_told_with_what_it_cannot_hear(plug):
    good, mute = await plug(MM=0), await plug(AO=0)
    result = await asyncio.to_thread(run, cli.devices, good.wire.port, mute.wire.port, "--json")
    found = json.loads(result.stdout)
    assert "cannot hear other PANs" in found[0]["what"] and "MM=1" in found[0]["advice"][0]
    assert "not usable" in found[1]["what"] and "AO=2" in found[1]["what"]
    assert found[0]["settings"] == {"AP": "2", "AO": "2", "MM": "0", "MY": "FFFE", "ID": "3332", "CH": "C"}


@pytest.mark.parametrize("options", [(), ("--json",)])
async def test_a_port_that_is_not_there_is_named_and_told_by_the_exit_code(plug, options):
    good = await plug()
    result = await asyncio.to_thread(run, cli.devices, "/dev/nowhere", good.wire.port, *options)
    assert result.exit_code == 1
    assert "no device at /dev/nowhere" in result.output and good.wire.port in result.output
    assert (await asyncio.to_thread(run, cli.devices, good.wire.port, *options)).exit_code == 0


async def test_a_mesh_module_is_told_with_what_it_cannot_hear(plug):
    radio = await plug("900hp")
    result = await asyncio.to_thread(run, cli.devices, radio.wire.port)
    assert "not usable as it is" in result.output and "its own mesh network only" in result.output


async def test_a_dongle_is_told_from_an_xbee(tmp_path):
    radio = PluggedModule(TiDongle(lambda: 0), PtyWire(tmp_path / "dongle"))
    await radio.plug()
    result = await asyncio.to_thread(run, cli.devices, radio.wire.port)
    radio.unplug()
    assert "ti-sniffer" in result.output and "every 802.15.4 frame" in result.output


async def test_channels_in_use_are_told_with_the_time_spent_scanning(plug):
    radio = await plug()
    radio.module.energy_dbm = {17: -55.0}
    arguments = (cli.channels, radio.wire.port, "--scans", "2", "--scan-s", "0.2")
    found = json.loads((await asyncio.to_thread(run, *arguments, "--json")).stdout)
    busy = [each["channel"] for each in found["channels"] if each["busy_share"] == 1.0]
    assert (found["scans"], busy, len(found["channels"])) == (2, [17], 16)
    assert found["not_listening_s"] >= 0.4 and len(found["over_time"]) == 2
    assert radio.module.transmitted == 0
    assert "     17      -55.0" in (await asyncio.to_thread(run, *arguments)).stdout


async def test_vehicles_heard_on_a_link_are_listed():
    port = free_udp_port()
    async with rovers_on_udp({3: (0.0, 0.0), 8: (1.0, 0.0)}, ScaledClock(5.0), port) as rovers:
        arguments = (cli.vehicles, "--address", f"udpin:127.0.0.1:{port}", "--seconds", "1", "--json")
        result = await asyncio.to_thread(run, *arguments)
    found = json.loads(result.stdout)
    assert [(each["system_id"], each["firmware"], each["mode"]) for each in found] == [
        (3, "ArduRover", "hold"),
        (8, "ArduRover", "hold"),
    ]
    assert not rovers[0].got, "listening sent something"


def test_what_a_radio_prints_is_shown_without_moving_the_terminal_and_with_what_to_do(tmp_path):
    path = tmp_path / "printed"
    for text, says in (
        ("\x1b[2J\x1b]0;x\x07 RSSI: -70 \u05e9\n" * 2, '  rss = "rss"'),
        ("+RCV=50,5,HELLO,-99,40\n", f"--receiver {path},rylr"),
        ("+RCV=50,5,HELLO,-99,40\n" * 30, "  and 10 more"),
        ("S=79\n", "write a map of your own"),
        ("", "its baud rate 115200?"),
    ):
        path.write_text(text)
        said = run(cli.devices, "--watch", str(path), "--seconds", "0.3").output
        assert says.lower() in said.lower() and "\x1b" not in said and "\x07" not in said
        if "S=79" in text:
            assert max(map(len, said.splitlines())) <= 80
