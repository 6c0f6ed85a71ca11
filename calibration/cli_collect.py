"""`fieldkit calibrate collect`: which receiver, which beacon, where positions come from."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calibration.options import headings, settings
from fieldkit.errors import ConfigError

if TYPE_CHECKING:
    from calibration.collect import Collector


def collect(
    out: Annotated[
        Path, typer.Option("--out", "-o", help="The CSV to fill; an unfinished one is gone on with.")
    ],
    receiver: Annotated[
        str,
        typer.Option(
            help="As in 'fieldkit walk': xbee:PORT, or PORT,MAP of a radio that prints, or a file such as "
            "radio.toml; or the name of a driver, with --set."
        ),
    ] = "xbee",
    setting: Annotated[
        list[str] | None,
        typer.Option("--set", help="Option of the driver, as port=/dev/ttyUSB0; repeatable."),
    ] = None,
    name: Annotated[str, typer.Option(help="What to call this receiver in the file.")] = "r1",
    period_s: Annotated[float, typer.Option(help="Time between the transmitter's packets.")] = 0.5,
    packets: Annotated[int, typer.Option(min=1, help="Packets to wait for at each place.")] = 20,
    beacon: Annotated[str, typer.Option(help="The transmitter's address; empty counts every sender.")] = "",
    turns: Annotated[
        int, typer.Option(min=0, help="Ask for the antenna to be turned to so many headings at each place.")
    ] = 0,
    vehicle: Annotated[
        str,
        typer.Option(
            help="Read positions from a vehicle: its driver, as mavlink. Needs --address, --origin."
        ),
    ] = "",
    positions: Annotated[
        str, typer.Option(help="Read positions from another source, as camera. Needs --address.")
    ] = "",
    address: Annotated[str, typer.Option(help="Where vehicle or camera are, as udpin:0.0.0.0:14550.")] = "",
    vehicle_setting: Annotated[
        list[str] | None,
        typer.Option("--vehicle-set", help="Option of vehicle or camera, as system_id=1; repeatable."),
    ] = None,
    origin: Annotated[
        tuple[float, float], typer.Option(help="The field's origin, latitude and longitude.")
    ] = (0.0, 0.0),
    transmitter: Annotated[
        tuple[float, float] | None,
        typer.Option(help="Where the transmitter stands, east and north of the origin in metres."),
    ] = None,
    record: Annotated[
        Path | None, typer.Option(help="The recording of everything heard (MCAP); else beside --out.")
    ] = None,
) -> None:
    """Collect readings place by place with a real receiver, counting the packets that do not arrive.

    Writes a CSV to fit, whole after every place, and a recording (MCAP) of everything heard beside it.
    Interrupted, it goes on with the CSV when started again.

    Example: fieldkit calibrate collect -o readings.csv --receiver /dev/ttyUSB0,rylr --period-s 5
    """
    from calibration import collect_log
    from calibration.collect import Beacon, Collector
    from calibration.positions import PositionFeed, by_position_source, by_telemetry
    from fieldkit import plugins
    from fieldkit.clock import RealClock
    from fieldkit.geo import FieldFrame
    from fieldkit.ports import DriverContext
    from fieldkit.receiver_file import receiver_of
    from fieldkit.recording import RecordingWriter

    if not period_s > 0.0:
        raise ConfigError(f"--period-s: expected a time above zero, got {period_s}")
    _check_positions(vehicle, positions, address, turns, origin)
    clock = RealClock()
    around = DriverContext(clock, FieldFrame(*origin))
    where = None
    if vehicle:
        link = by_telemetry(vehicle, address, name, settings(vehicle_setting), around)
        where = PositionFeed(name, link, transmitter)
    elif positions:
        source = by_position_source(positions, address, name, settings(vehicle_setting), around)
        where = PositionFeed(name, source, transmitter)
    # A bare word is the name of a driver, whose options --set gives.
    table = receiver_of(receiver) if set(receiver) & set("./:,") else {"driver": receiver}
    options = {key: value for key, value in table.items() if key != "driver"} | settings(setting)
    opened = plugins.load("fieldkit.receivers", table["driver"])(name, options, around)
    log = collect_log.free_path(out.with_suffix(".mcap")) if record is None else record
    said = collect_log.metadata(beacon, period_s, packets)
    writer = RecordingWriter(log, start_ns=clock.now_ns(), metadata=said)
    collector = Collector(
        opened,
        clock,
        Beacon(period_s, packets, beacon),
        out,
        _ask,
        typer.echo,
        collect_log.CollectLog(writer),
        where,
        headings(turns),
        _show if sys.stdout.isatty() else lambda text: None,
    )
    try:
        with writer:
            cut = _collected(collector)
    finally:
        if not collector.begun:  # of a radio that is not there nothing was recorded
            log.unlink(missing_ok=True)
    count = len({place.name for place in collector.places})
    typer.echo(f"{cut}{out}: {count} place{'s' * (count != 1)}; recording: {log}")
    if cut:
        typer.echo("to go on with it: the same command")
        raise typer.Exit(130)
    if count:
        typer.echo(f"now: fieldkit calibrate fit {out} -o antenna.toml --report report.html")


def _collected(collector: "Collector") -> str:
    """Collect; what is to be said where it was interrupted, or nobody answers any more."""
    import asyncio

    try:
        asyncio.run(collector.run())
    except (KeyboardInterrupt, typer.Abort):
        return "\ninterrupted; "
    return ""


def _check_positions(
    vehicle: str, positions: str, address: str, turns: int, origin: tuple[float, float]
) -> None:
    """Raises `ConfigError` where the options for measured positions contradict each other."""
    if vehicle and positions:
        raise ConfigError("--vehicle and --positions: positions come from one of them; leave one out")
    if (vehicle or positions) and not address:
        raise ConfigError("--address: where is it? as udpin:0.0.0.0:14550 for a vehicle's telemetry")
    if (vehicle or positions) and turns:
        raise ConfigError(
            "--turns: with --vehicle or --positions the heading is measured; turn the robot instead"
        )
    if vehicle and origin == (0.0, 0.0):
        raise ConfigError("--origin: give latitude and longitude of some point of the field, within a few km")


def _ask(question: str) -> str:
    return str(typer.prompt(question, default="", show_default=False))


def _show(text: str) -> None:
    """On the same line of the terminal, over what stood there."""
    typer.echo(f"\r{text:<78}\r", nl=False)
