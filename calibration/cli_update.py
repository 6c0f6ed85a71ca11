"""`fieldkit calibrate update`: an antenna file improved by what a mission heard of a source whose place is known."""

import json
from pathlib import Path
from typing import Annotated

import typer


def update(
    antenna: Annotated[Path, typer.Argument(help="The antenna file in use.")],
    log: Annotated[Path, typer.Argument(help="The recording of a mission (MCAP).")],
    out: Annotated[Path, typer.Option("--out", "-o", help="The new antenna file to write.")],
    source: Annotated[
        tuple[float, float] | None,
        typer.Option(help="Where a source stands that you know: east and north in metres."),
    ] = None,
    found: Annotated[
        int | None, typer.Option(help="Or the number of a source that the mission has found.")
    ] = None,
    level_db: Annotated[
        float | None,
        typer.Option(
            help="How much stronger it sends than the calibrated transmitter (0: the same); else its power is unknown."
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result alone, as JSON.")] = False,
) -> None:
    """Improve an antenna file by a mission's own readings of a source, or say that they contradict it.

    Writes a new file, which names both it came from. Nothing is written, and the exit code is 1, where the readings
    contradict the file; 2 where they say too little.

    Example: fieldkit calibrate update antenna.toml mission.mcap --found 3 -o better.toml
    """
    import hashlib

    from calibration import update as updating
    from calibration.own_readings import own_readings
    from fieldkit.channel.antenna_file import dump_antenna, read_antenna
    from fieldkit.console import folded
    from fieldkit.errors import ConfigError
    from fieldkit.files import write_whole

    if source is not None and found is not None:
        raise ConfigError("--source and --found: give one of them")
    if level_db is not None and not abs(level_db) < 100.0:
        raise ConfigError(f"--level-db: expected dB between -100 and 100, got {level_db}")
    file = read_antenna(antenna, allow_pattern=True)
    readings, note = own_readings(log, file, source, found)
    sha256 = hashlib.sha256(antenna.read_bytes()).hexdigest()
    done = updating.update(file, readings, level_db=level_db, old_sha256=sha256)
    if done.file is not None:
        write_whole(out, dump_antenna(done.file))
    if as_json:
        said = {
            "state": done.state,
            "reasons": list(done.reasons),
            "note": note,
            "n_places": readings.n_places,
        }
        chance = done.p_chance if done.p_chance == done.p_chance else None
        typer.echo(json.dumps({**said, "p_chance": chance, "out": str(out) if done.file else None}))
    else:
        lines = [*done.lines, note, f"verdict: {done.state}", *(f"  {text}" for text in done.reasons)]
        typer.echo(folded("\n".join(lines)))
        if done.file is not None:
            typer.echo(f"{out}: written")
    if done.file is None:
        raise typer.Exit(1 if done.state == "contradicts" else 2)
