"""`fieldkit survey`. What it needs is imported when it runs."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from fieldkit import settings as given

if TYPE_CHECKING:
    from drivers.positions.survey import Result


def survey(
    readings: Annotated[Path, typer.Argument(help="Readings: .csv, .mcap, .pcap, .pcapng, a ROS 2 bag.")],
    positions: Annotated[
        Path, typer.Argument(help="Positions: .csv, .gpx, .tlog, .bin, .mcap, a ROS 2 bag.")
    ],
    antenna: Annotated[Path, typer.Option(help="Antenna file of the radio that was carried.")],
    robot: Annotated[str, typer.Option(help="Name of the only receiver, where a log has none.")] = "radio",
    margin_m: Annotated[
        float | None,
        typer.Option(
            min=0.1, help="How far beyond the path to look; default: 0.6 of its width, 20 m or more."
        ),
    ] = None,
    cell_m: Annotated[
        float | None, typer.Option(min=0.01, help="No longer used: regions are as fine as they need be.")
    ] = None,
    power_db: Annotated[
        list[float] | None,
        typer.Option(
            help="Known power above the calibrated transmitter's; repeat for several. Default: unknown."
        ),
    ] = None,
    power_sd_db: Annotated[
        float | None, typer.Option(min=0.0, help="How far its power may be from the calibrated ones'.")
    ] = None,
    source_up_m: Annotated[
        float, typer.Option(help="Height of the transmitters, as the positions count it.")
    ] = 0.0,
    identity: Annotated[
        Literal["anonymous", "address"], typer.Option(help="address: each sender's name is one source.")
    ] = given.IDENTITY,
    relative: Annotated[
        bool, typer.Option("--relative", help="Levels are dB against anything, not dBm.")
    ] = False,
    found_within_m: Annotated[
        float | None,
        typer.Option(min=0.01, help="A find is this near; default: 2 m or a tenth of the range."),
    ] = None,
    found_probability: Annotated[
        float, typer.Option(min=0.01, max=0.999, help="With this probability.")
    ] = given.FOUND_PROBABILITY.default,
    rate_hz: Annotated[
        float, typer.Option(min=1e-6, help="How often a typical source sends.")
    ] = given.RATE_HZ.default,
    expected: Annotated[float, typer.Option(min=0.01, help="Sources expected beforehand.")] = 1.0,
    window_s: Annotated[
        float, typer.Option(min=0.001, help="Receptions this close are one packet.")
    ] = given.WINDOW_S.default,
    max_gap_s: Annotated[
        float, typer.Option(min=0.1, help="Longest gap between positions.")
    ] = given.SURVEY_GAP_S,
    shift_s: Annotated[float, typer.Option(help="Added to the readings' times.")] = 0.0,
    geojson: Annotated[Path | None, typer.Option(help="Write candidates and path to this file.")] = None,
    topics: Annotated[
        Path | None, typer.Option(help="Which topics of a ROS 2 bag have readings: see docs/hardware.md.")
    ] = None,
    allow_refused: Annotated[bool, typer.Option(help="Use an antenna file whose fit was refused.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Locate transmitters from a log of readings and a log of positions, of a radio carried by hand.

    Example: fieldkit survey readings.csv walk.gpx --antenna antenna.toml --geojson found.geojson
    """
    import json

    from drivers.positions.readings import read_readings
    from drivers.positions.survey import Settings, as_geojson, evaluate
    from drivers.positions.survey import as_json as plain
    from drivers.positions.tracks import ONLY, read_track
    from fieldkit.channel.antenna_file import read_antenna, spread_of
    from fieldkit.console import progress
    from fieldkit.files import keep_apart, write_whole

    for read in (readings, positions, antenna):
        keep_apart(read, geojson)
    file = read_antenna(antenna, allow_refused=allow_refused)
    track = read_track(positions)
    if {spot.robot for spot in track.spots} == {ONLY} and robot != ONLY:
        track = read_track(positions, robot)
    settings = Settings(
        file.antenna,
        margin_m,
        cell_m,
        tuple(power_db or ()),
        rate_hz,
        expected,
        window_s,
        max_gap_s,
        shift_s,
        spread=spread_of(file),
        receivers=file.receivers,
        power_sd_db=power_sd_db,
        source_up_m=source_up_m,
        identity=identity == "address",
        found_within_m=found_within_m,
        found_probability=found_probability,
    )
    notes: list[str] = []
    heard = read_readings(readings, robot, relative=relative, notes=notes, topics=topics)
    if assumption := spread_of(file).assumed:
        notes.append(f"{antenna.name}: {assumption}")
    with progress("locating") as report:
        result = evaluate(heard, track, settings, lambda share: report(share, ""))
    result.notes[:0] = notes
    if geojson is not None:
        write_whole(geojson, json.dumps(as_geojson(result, track)))
    if as_json:
        typer.echo(json.dumps(plain(result)))
        return
    _print(result, plain(result))
    if geojson is not None:
        typer.echo(f"written: {geojson}")


def _print(result: "Result", plain: dict[str, Any]) -> None:
    """The result in words; `plain` is its JSON."""
    typer.echo(
        f"{result.readings} readings in {result.duration_s:.0f} s, {result.detections} transmissions; "
        f"{result.without_place} readings at moments without a position"
    )
    for note in plain["notes"]:
        typer.echo(f"note: {note}")
    for each in plain["candidates"]:
        place = f"{each['east_m']:8.2f} m east {each['north_m']:8.2f} m north"
        if "lat_deg" in each:
            place += f"  ({each['lat_deg']:.6f}, {each['lon_deg']:.6f})"
        typer.echo(
            f"{each['state']:9} {place}  +- {each['sigma_m']:.2f} m, {each['receptions']:.0f} receptions"
            + (f"; {each['note']}" if each["note"] else "")
        )
    if not plain["candidates"]:
        typer.echo("no transmitter found")
