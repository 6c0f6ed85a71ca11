"""`fieldkit calibrate`: from logged readings to an antenna file, or a clear no (exit code 2)."""

import json
from pathlib import Path
from typing import Annotated, Literal

import typer

from fieldkit.errors import ConfigError

HELP = "Turn logged readings into an antenna file that a mission can trust, or say why they cannot carry one."
app = typer.Typer(help=HELP, no_args_is_help=True, rich_markup_mode=None)

_JSON = Annotated[bool, typer.Option("--json", help="Print the result alone, as JSON.")]
_COLUMN = Annotated[
    list[str] | None, typer.Option("--column", help="Our column = yours, as rss_dbm=RSSI; repeat for more.")
]
_WHERE = Annotated[
    list[str] | None,
    typer.Option("--where", help="Keep only rows with this value, as room=room1; repeatable."),
]
_PLACE = Annotated[
    float | None, typer.Option("--place-cell-m", help="Positions in one cell of this size are one place.")
]
_NEGATE = Annotated[
    bool, typer.Option("--negate", help="Readings are given as -dBm, as radios' raw bytes are.")
]


@app.command()
def fit(
    readings: Annotated[Path, typer.Argument(help="CSV of readings; columns in docs/calibration.md.")],
    out: Annotated[Path | None, typer.Option("--out", "-o", help="The antenna file to write.")] = None,
    plot: Annotated[Path | None, typer.Option("--plot", help="Write a picture of the fit (PNG).")] = None,
    report: Annotated[Path | None, typer.Option("--report", help="Write one offline HTML page.")] = None,
    column: _COLUMN = None,
    where: _WHERE = None,
    missed: Annotated[
        Literal["auto", "counted", "none", "uncounted"],
        typer.Option(
            help="Whether packets not received are in the file: counted, none were lost, or uncounted."
        ),
    ] = "auto",
    saturation_dbm: Annotated[
        float | None, typer.Option(help="The receiver reports no more than this.")
    ] = None,
    min_distance_m: Annotated[float, typer.Option(help="Leave out nearer readings.")] = 0.0,
    receiver_offsets: Annotated[
        bool, typer.Option("--receiver-offsets", help="Find how each receiver differs from the first.")
    ] = False,
    pattern: Annotated[
        Literal["none", "auto", "circle", "ellipse", "lobe", "dipole", "fourier", "spline"],
        typer.Option(help="Gain by heading (column heading_deg): auto chooses by BIC."),
    ] = "none",
    place_cell_m: _PLACE = None,
    negate: _NEGATE = False,
    radio: Annotated[str, typer.Option(help="Radio and its settings, to be remembered in the file.")] = "",
    keep_refused: Annotated[
        bool,
        typer.Option("--keep-refused", help="Write the files even if refused; missions still refuse them."),
    ] = False,
    as_json: _JSON = False,
) -> None:
    """Fit received power against distance and judge whether it can be relied on.

    Refused: exit code 2, and no file is written.

    Example: fieldkit calibrate fit examples/readings.csv -o antenna.toml --plot fit.png
    """
    from calibration import output
    from calibration.dataset import read_readings
    from calibration.fit import Options
    from calibration.fit import fit as fit_readings
    from calibration.verdict import judge
    from fieldkit.antenna.file import dump_antenna
    from fieldkit.files import write_whole

    data = read_readings(
        readings, names=_pairs(column), where=_pairs(where), place_cell_m=place_cell_m, negate=negate
    )
    options = Options(missed, saturation_dbm, min_distance_m, receiver_offsets)
    if pattern == "none":
        result, shape = fit_readings(data, options), None
    else:
        from calibration.patterns import fit_pattern

        result, shape = fit_pattern(data, options, pattern)
    judgement = judge(result)
    refused = judgement.state == "refused"
    if not refused or keep_refused:
        if plot is not None:
            from calibration.plots import save_plot

            save_plot(result, plot)
        if report is not None:
            from calibration.report import report_html

            write_whole(report, report_html(result, judgement, shape))
        if out is not None:
            write_whole(out, dump_antenna(output.antenna_file(result, judgement, radio, shape)))
    if as_json:
        typer.echo(json.dumps(output.plain(result, judgement, shape)))
    else:
        typer.echo(output.words(result, judgement, shape))
    if refused:
        raise typer.Exit(2)


def _pairs(texts: list[str] | None) -> dict[str, str]:
    pairs = {}
    for text in texts or []:
        name, sign, value = text.partition("=")
        if not sign:
            raise ConfigError(f"expected NAME=VALUE, got '{text}'")
        pairs[name.strip()] = value.strip()
    return pairs


@app.command()
def check(
    antenna: Annotated[Path, typer.Argument(help="The antenna file in use.")],
    readings: Annotated[Path, typer.Argument(help="New readings, a CSV as for fit.")],
    column: _COLUMN = None,
    where: _WHERE = None,
    place_cell_m: _PLACE = None,
    negate: _NEGATE = False,
    as_json: _JSON = False,
) -> None:
    """Say whether a calibration still holds on new readings (exit code 1 if it has drifted).

    Example: fieldkit calibrate check antenna.toml today.csv
    """
    from dataclasses import asdict

    from calibration.check import check as compare
    from calibration.dataset import read_readings
    from fieldkit.antenna.file import read_antenna

    file = read_antenna(antenna, allow_refused=True)
    data = read_readings(
        readings, names=_pairs(column), where=_pairs(where), place_cell_m=place_cell_m, negate=negate
    )
    said = compare(file, data)
    if as_json:
        typer.echo(json.dumps(asdict(said)))
    else:
        low, high = said.offset_95
        typer.echo(f"offset {said.offset_db:+.1f} dB ({low:+.1f} to {high:+.1f}) against the calibration")
        typer.echo(f"spread {said.sigma_db:.1f} dB, calibrated {said.calibrated_sigma_db:.1f} dB")
        typer.echo(f"verdict: {said.state}")
        for reason in said.reasons:
            typer.echo(f"  {reason}")
    if said.state != "holds":
        raise typer.Exit(1)


@app.command("import")
def import_(
    log: Annotated[Path, typer.Argument(help="A CSV under other names, or a mission.mcap.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="The CSV of readings to write.")],
    column: _COLUMN = None,
    where: _WHERE = None,
    source: Annotated[
        tuple[float, float] | None,
        typer.Option(help="For a recording: where its only transmitter stood, east and north in metres."),
    ] = None,
) -> None:
    """Turn another log into a CSV of readings that fit and check take.

    Example: fieldkit calibrate import mission.mcap --source 5.0 5.0 -o readings.csv
    """
    from calibration.dataset import read_readings
    from calibration.importing import csv_from_recording, csv_from_table
    from fieldkit.files import write_whole

    if log.suffix == ".mcap":
        if source is None:
            raise ConfigError("--source: expected the transmitter's east and north in metres; got nothing")
        text = csv_from_recording(log, *source)
    else:
        text = csv_from_table(log, _pairs(column), _pairs(where))
    existed = out.exists()
    previous = out.read_bytes() if existed else b""
    write_whole(out, text)
    try:
        data = read_readings(out)
    except ValueError:
        # What cannot be read back helps nobody: leave things as they were.
        if existed:
            write_whole(out, previous)
        else:
            out.unlink()
        raise
    typer.echo(f"{out}: {int((~data.missed).sum())} readings, {int(data.missed.sum())} missed packets")


@app.command()
def collect(
    out: Annotated[
        Path, typer.Option("--out", "-o", help="The CSV to fill; an unfinished one is gone on with.")
    ],
    receiver: Annotated[str, typer.Option(help="Receiver driver, as in mission.toml.")] = "xbee",
    setting: Annotated[
        list[str] | None,
        typer.Option("--set", help="Option of the driver, as port=/dev/ttyUSB0; repeatable."),
    ] = None,
    name: Annotated[str, typer.Option(help="What to call this receiver in the file.")] = "r1",
    period_s: Annotated[float, typer.Option(help="Time between the transmitter's packets.")] = 0.5,
    packets: Annotated[int, typer.Option(min=1, help="Packets to wait for at each place.")] = 20,
    source: Annotated[str, typer.Option(help="The transmitter's address; empty counts every sender.")] = "",
    record: Annotated[Path | None, typer.Option(help="Also record everything heard (MCAP).")] = None,
) -> None:
    """Collect readings place by place with a real receiver, counting the packets that do not arrive.

    Example: fieldkit calibrate collect -o readings.csv --set port=/dev/ttyUSB0 --period-s 0.5
    """
    import asyncio
    from contextlib import nullcontext

    from calibration.collect import Beacon
    from calibration.collect import collect as run
    from fieldkit import plugins
    from fieldkit.clock import RealClock
    from fieldkit.geo import FieldFrame
    from fieldkit.ports import Surroundings
    from fieldkit.recording import RecordingWriter

    if period_s <= 0.0:
        raise ConfigError(f"--period-s: expected a time above zero, got {period_s}")
    clock = RealClock()
    opened = plugins.load("fieldkit.receivers", receiver)(
        name, _pairs(setting), Surroundings(clock, FieldFrame(0.0, 0.0))
    )
    beacon = Beacon(period_s, packets, source)
    with RecordingWriter(record, start_ns=clock.now_ns()) if record else nullcontext() as recorder:
        places = asyncio.run(run(opened, clock, beacon, out, typer.prompt, typer.echo, recorder))
    typer.echo(f"{out}: {len(places)} places; now: fieldkit calibrate fit {out} -o antenna.toml")
