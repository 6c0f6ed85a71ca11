"""`fieldkit survey`. What it needs is imported when it runs."""

from pathlib import Path
from typing import Annotated

import typer


def survey(
    readings: Annotated[Path, typer.Argument(help="Readings: .csv, .mcap, .pcap or .pcapng.")],
    positions: Annotated[Path, typer.Argument(help="Positions: .csv, .gpx, .tlog, .bin or .mcap.")],
    antenna: Annotated[Path, typer.Option(help="Antenna file of the radio that was carried.")],
    robot: Annotated[str, typer.Option(help="Name of the only receiver, where a log has none.")] = "radio",
    margin_m: Annotated[float, typer.Option(min=0.1, help="How far beyond the path to look.")] = 20.0,
    cell_m: Annotated[
        float | None, typer.Option(min=0.01, help="Cell size; default: 80 along a side.")
    ] = None,
    power_db: Annotated[
        list[float] | None, typer.Option(help="Power above the calibrated transmitter's; repeat for several.")
    ] = None,
    rate_hz: Annotated[float, typer.Option(min=1e-6, help="How often a typical source sends.")] = 0.05,
    expected: Annotated[float, typer.Option(min=0.01, help="Sources expected beforehand.")] = 1.0,
    window_s: Annotated[float, typer.Option(min=0.001, help="Receptions this close are one packet.")] = 0.1,
    max_gap_s: Annotated[float, typer.Option(min=0.1, help="Longest gap between positions.")] = 5.0,
    shift_s: Annotated[float, typer.Option(help="Added to the readings' times.")] = 0.0,
    geojson: Annotated[Path | None, typer.Option(help="Write candidates and path to this file.")] = None,
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
    from fieldkit.channel.antenna_file import read_antenna
    from fieldkit.files import write_whole

    radio = read_antenna(antenna, allow_refused=allow_refused).antenna
    track = read_track(positions)
    if {spot.robot for spot in track.spots} == {ONLY} and robot != ONLY:
        track = read_track(positions, robot)
    settings = Settings(
        radio,
        margin_m,
        cell_m,
        tuple(power_db or (0.0,)),
        rate_hz,
        expected,
        window_s,
        max_gap_s,
        shift_s,
    )
    result = evaluate(read_readings(readings, robot), track, settings)
    if geojson is not None:
        write_whole(geojson, json.dumps(as_geojson(result, track)))
    told = plain(result)
    if as_json:
        typer.echo(json.dumps(told))
        return
    typer.echo(
        f"{result.readings} readings in {result.duration_s:.0f} s, {result.detections} transmissions; "
        f"{result.without_place} readings at moments without a position"
    )
    for each in told["candidates"]:
        place = f"{each['east_m']:8.2f} m east {each['north_m']:8.2f} m north"
        if "lat_deg" in each:
            place += f"  ({each['lat_deg']:.6f}, {each['lon_deg']:.6f})"
        typer.echo(
            f"{each['state']:9} {place}  +- {each['sigma_m']:.2f} m, {each['receptions']:.0f} receptions"
            + (f"; {each['note']}" if each["note"] else "")
        )
    if not told["candidates"]:
        typer.echo("no transmitter found")
    if geojson is not None:
        typer.echo(f"written: {geojson}")
