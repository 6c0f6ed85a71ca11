"""`fieldkit camera`: calibrate, and look at what is found. OpenCV is imported by the commands."""

from pathlib import Path
from typing import Annotated, Any

import typer

from fieldkit import settings as given

app = typer.Typer(
    help="Overhead camera. Example: fieldkit camera calibrate rtsp://10.0.0.9/1 camera.toml",
    no_args_is_help=True,
    rich_markup_mode=None,
)

Source = Annotated[
    str, typer.Argument(metavar="SOURCE", help="URL, USB camera's number, video file or picture.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]


@app.callback()
def _group() -> None:
    """Overhead camera."""


@app.command()
def calibrate(
    source: Source,
    points: Annotated[Path, typer.Argument(metavar="CAMERA.TOML", help="File with the known points.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Picture to write.")] = Path("camera.png"),
    cell_m: Annotated[float, typer.Option(min=0.05, help="Distance of the grid's lines.")] = 1.0,
    as_json: AsJson = False,
) -> None:
    """Fit the field to known points: writes the picture with the fitted grid, and prints each point's residual.

    The points file has `schema = 1` and `points = [[x, y, east, north], ...]`: pixels, then metres; four or more.

    Example: fieldkit camera calibrate 0 camera.toml --out camera.png
    """
    import json

    import numpy as np

    from drivers.camera.draw import draw_grid, one_picture, write_picture
    from drivers.camera.file import read_points
    from drivers.camera.view import fit_view

    pixels, field_m, lens, camera_m = read_points(points)
    view = fit_view(pixels, field_m, lens=lens, camera_m=camera_m)
    picture = one_picture(source)
    write_picture(out, draw_grid(picture, view, pixels, field_m, cell_m))
    residual_cm = view.residual_m * 100
    result: dict[str, Any] = {
        "points": len(pixels),
        "residual_cm": [round(float(each), 2) for each in residual_cm],
        "rms_cm": round(view.rms_m * 100, 2),
        "worst_cm": round(float(residual_cm.max()), 2),
        "cm_per_pixel": round(100 * view.metres_per_pixel(np.mean(pixels, axis=0)), 2),
        "checked": len(pixels) > 4,
        "picture": str(out),
    }
    if as_json:
        typer.echo(json.dumps(result))
        return
    for (x, y), (east, north), each in zip(pixels, field_m, residual_cm, strict=True):
        typer.echo(
            f"({x:7.1f}, {y:7.1f}) px  {east:7.2f} m east {north:7.2f} m north   residual {each:5.1f} cm"
        )
    typer.echo(
        f"residual {result['rms_cm']:.1f} cm (rms), {result['cm_per_pixel']:.1f} cm a pixel; written: {out}"
    )
    if not result["checked"]:
        typer.echo("four points are always met exactly: add more to see how good the fit is")


@app.command()
def look(
    source: Source,
    calibration: Annotated[Path, typer.Argument(metavar="CAMERA.TOML", help="Calibration file.")],
    marker: Annotated[list[str], typer.Option(help="ROBOT=NUMBER; repeat for each robot.")],
    height_m: Annotated[float, typer.Option(min=0.0, help="Markers' height above the ground.")] = 0.0,
    family: Annotated[str, typer.Option(help="aruco-4x4 ... apriltag-36h11.")] = given.MARKERS,
    out: Annotated[Path, typer.Option("--out", "-o", help="Picture to write.")] = Path("camera.png"),
    as_json: AsJson = False,
) -> None:
    """Find robots in one picture, say where they are, and draw it.

    Example: fieldkit camera look 0 camera.toml --marker ada=3 --marker bob=7
    """
    import json
    from dataclasses import asdict

    from drivers.camera.capture import Finder
    from drivers.camera.draw import draw_fixes, one_picture, write_picture
    from drivers.camera.source import CameraOptions, make_task
    from fieldkit.errors import ConfigError

    robots: dict[str, Any] = {}
    for each in marker:
        name, _, number = each.partition("=")
        if not name or not number.isdigit():
            raise ConfigError(f"--marker: expected ROBOT=NUMBER, got {each!r}")
        robots[name] = {"marker": int(number), "height_m": height_m}
    task = make_task(CameraOptions(source, str(calibration), robots, family))
    picture = one_picture(source)
    finder = Finder(task)
    fixes = finder.fixes(picture, 0.0)
    write_picture(out, draw_fixes(picture, task.view, fixes))
    if as_json:
        typer.echo(
            json.dumps({"robots": [asdict(fix) for fix in fixes], "inconsistent": finder.judge.inconsistent})
        )
        return
    for fix in fixes:
        typer.echo(
            f"{fix.robot}: {fix.east_m:.2f} m east, {fix.north_m:.2f} m north, heading {fix.heading_deg:.0f} deg, "
            f"+- {100 * fix.sigma_m:.0f} cm"
        )
    for robot in robots:
        if robot not in {fix.robot for fix in fixes}:
            typer.echo(f"{robot}: {finder.judge.inconsistent.get(robot, 'not seen')}")
    typer.echo(f"written: {out}")
