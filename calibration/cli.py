"""`fieldkit calibrate`: from logged readings to an antenna file, or a clear no (exit code 2)."""

import json
from pathlib import Path
from typing import Annotated, Literal

import typer

from calibration.cli_collect import collect
from calibration.cli_update import update
from calibration.options import pairs as _pairs
from fieldkit import settings as given

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
_SOURCE = Annotated[
    tuple[float, float] | None,
    typer.Option(
        help="Where the only transmitter stood: east and north in metres (or latitude and longitude)."
    ),
]
_POSITIONS = Annotated[
    Path | None, typer.Option(help="A position log (CSV with time) for readings without positions.")
]
_OFFSET = Annotated[
    float | None, typer.Option(help="Seconds to add to the readings' times before looking up positions.")
]
_NEGATE = Annotated[
    bool, typer.Option("--negate", help="Readings are given as -dBm, as radios' raw bytes are.")
]


@app.command()
def fit(
    readings: Annotated[
        Path, typer.Argument(help="CSV of readings (columns in docs/calibration.md), recording or report.")
    ],
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
    ] = given.MISSED,
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
    ] = given.PATTERN,
    place_cell_m: _PLACE = None,
    negate: _NEGATE = False,
    relative: Annotated[
        bool, typer.Option("--relative", help="Levels are dB against anything, not dBm.")
    ] = False,
    source: _SOURCE = None,
    radio: Annotated[
        str, typer.Option(help="Settings of the radios, as 'PL=4, channel 15', to be remembered in the file.")
    ] = "",
    family: Annotated[str, typer.Option(help="Kind of radio, as 'XBee S2C', to be remembered.")] = "",
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
    from dataclasses import replace

    from calibration import output
    from calibration.fit import Options
    from calibration.fit import fit as fit_readings
    from calibration.logs import Reading, read_log
    from calibration.verdict import judge
    from fieldkit.channel.antenna_file import dump_antenna
    from fieldkit.console import folded, progress
    from fieldkit.files import keep_apart, write_whole

    keep_apart(readings, out, plot, report)
    how = Reading(_pairs(column), _pairs(where), place_cell_m, negate, source, relative=relative)
    data, notes = read_log(readings, how)
    data = replace(data, warnings=(*data.warnings, *notes))
    options = Options(missed, saturation_dbm, min_distance_m, receiver_offsets)
    with progress("fitting"):
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
            write_whole(out, dump_antenna(output.antenna_file(result, judgement, radio, shape, family)))
    if as_json:
        typer.echo(json.dumps(output.plain(result, judgement, shape)))
    else:
        typer.echo(folded(output.words(result, judgement, shape)))
        written = [path for path in (out, plot, report) if path is not None]
        if refused and written and not keep_refused:
            typer.echo("nothing was written")
        elif written:
            typer.echo(f"written: {', '.join(map(str, written))}")
    if refused:
        raise typer.Exit(2)


@app.command()
def check(
    antenna: Annotated[Path, typer.Argument(help="The antenna file in use.")],
    log: Annotated[Path, typer.Argument(help="New readings: a CSV as for fit, or a recording (MCAP).")],
    column: _COLUMN = None,
    where: _WHERE = None,
    place_cell_m: _PLACE = None,
    negate: _NEGATE = False,
    source: _SOURCE = None,
    as_json: _JSON = False,
) -> None:
    """Say whether a calibration still holds on new readings (exit code 1 if it does not).

    Example: fieldkit calibrate check antenna.toml today.csv
    """
    from dataclasses import asdict

    from calibration import check as checking
    from calibration.logs import Reading, read_log
    from fieldkit.channel.antenna_file import read_antenna
    from fieldkit.console import folded

    file = read_antenna(antenna, allow_refused=True, allow_pattern=True)
    data, notes = read_log(log, Reading(_pairs(column), _pairs(where), place_cell_m, negate, source))
    said = checking.check(file, data)
    notes = [*data.warnings, *notes]
    if as_json:
        typer.echo(json.dumps({**asdict(said), "warnings": notes}))
    else:
        typer.echo(folded("\n".join([*checking.words(said), *(f"  warning: {note}" for note in notes)])))
    if said.state != "holds":
        raise typer.Exit(1)


@app.command("import")
def import_(
    log: Annotated[
        Path, typer.Argument(help="A CSV under other names, a recording (MCAP), or our own report.")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="The CSV of readings to write.")],
    column: _COLUMN = None,
    where: _WHERE = None,
    source: _SOURCE = None,
    positions: _POSITIONS = None,
    clock_offset_s: _OFFSET = None,
    negate: _NEGATE = False,
) -> None:
    """Turn another log into a CSV of readings that fit and check take.

    Nothing is written if the log cannot be used; what is inconsistent about it is said.

    Example: fieldkit calibrate import mission.mcap --source 5.0 5.0 -o readings.csv
    """
    from calibration.dataset import read_readings
    from calibration.importing import csv_from_table
    from calibration.logs import Reading, as_readings_csv
    from fieldkit.files import keep_apart, write_whole

    keep_apart(log, out)
    how = Reading(_pairs(column), _pairs(where), None, negate, source, positions, clock_offset_s)
    text, notes = as_readings_csv(log, how)
    if text is None:
        # Read the original once, so that errors name its lines.
        read_readings(log, names=how.names, where=how.where, negate=negate)
        text = csv_from_table(log, how.names, how.where, negate=negate)
    data = read_readings(log, text=text)
    write_whole(out, text)
    typer.echo(
        f"{out}: {int((~data.missed).sum())} readings, {int(data.missed.sum())} missed packets, "
        f"{data.n_places} places"
    )
    for note in (*data.warnings, *notes):
        typer.echo(f"  warning: {note}")


app.command()(update)
app.command()(collect)
