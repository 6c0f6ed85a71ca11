"""Pictures of a fit: readings against distance with the band, residuals against whatever is known."""

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from calibration import diagnose
from calibration.fit import FitResult
from calibration.patterns import Pattern
from calibration.profile import Profile
from fieldkit.look import MEASURED, MODEL
from fieldkit.messages import FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BAND_SIGMA = 1.96
_MOST_POINTS = 20_000
MOST_SHAPES = 1_000
"""More points than these are a picture within the figure: each as a shape of its own makes a page slow."""


def fit_figure(result: FitResult) -> "Figure":
    """Readings against distance, the fitted mean with its 95 % band, threshold and saturation."""
    figure, axes = _figure(7.0, 4.5)
    distance, level, count = _counted(result)
    axes.scatter(
        distance,
        level,
        s=6.0 + 3.0 * np.sqrt(count),
        color=MEASURED,
        alpha=0.6,
        linewidths=0,
        rasterized=len(distance) > MOST_SHAPES,
        label="readings" if result.readings.gain_db is None else "readings less the antenna's gain",
    )
    r = result.readings
    line = np.geomspace(r.distance_m.min(), r.distance_m.max(), 200)
    mean, band = result.mean_dbm(line), BAND_SIGMA * result.antenna.sigma_db
    axes.plot(line, mean, color=MODEL, label=f"fit, exponent {result.antenna.path_loss_exponent:.2f}")
    axes.fill_between(line, mean - band, mean + band, color=MODEL, alpha=0.12, label="95 % of readings")
    if r.missed.any():
        low = result.antenna.threshold_dbm
        axes.axhline(low, color="grey", linestyle="--", linewidth=1, label=f"threshold {low:.0f} dBm")
        spread = np.full(int(r.missed.sum()), low - 2.0)
        axes.scatter(r.distance_m[r.missed], spread, marker="|", color="grey", label="missed")
    if result.antenna.saturation_dbm is not None:
        axes.axhline(
            result.antenna.saturation_dbm, color="grey", linestyle=":", linewidth=1, label="saturation"
        )
    axes.set(xlabel="distance (m)", ylabel="reading (dBm)", title=r.name)
    _log_distance(axes)
    axes.legend(fontsize="small")
    return figure


def residual_figures(result: FitResult) -> "dict[str, Figure]":
    """Residuals against distance, place, and heading and time where they are known. Title to figure.

    Far away only what was heard has a residual: those lie above zero although the fit is right.
    """
    r = result.readings
    axes_of: dict[str, tuple[FloatArray, str]] = {
        "distance": (r.distance_m, "distance (m)"),
        "place": (r.place.astype(float), "place, in the order of the file"),
    }
    if r.heading_deg is not None:
        axes_of["heading"] = (r.heading_deg, "heading (deg)")
    if r.order is not None:
        axes_of["time"] = (r.order - np.nanmin(r.order), "time (s) or packet number")
    residual = diagnose.residuals_db(result)
    pictures = {}
    for name, (x, label) in axes_of.items():
        figure, axes = _figure(7.0, 2.6)
        shown = np.flatnonzero(~r.missed)
        shown = shown[:: max(1, len(shown) // _MOST_POINTS)]
        axes.scatter(
            x[shown],
            residual[shown],
            s=5,
            color=MEASURED,
            alpha=0.4,
            linewidths=0,
            rasterized=len(shown) > MOST_SHAPES,
        )
        axes.axhline(0.0, color=MODEL, linewidth=1)
        for sign in (-1, 1):
            axes.axhline(
                sign * BAND_SIGMA * result.antenna.sigma_db, color=MODEL, linewidth=0.7, linestyle=":"
            )
        axes.set(xlabel=label, ylabel="residual (dB)")
        if name == "distance":
            _log_distance(axes)
        pictures[name] = figure
    return pictures


def polar_figure(pattern: Pattern) -> "Figure":
    """Gain by heading, the antenna's front up, clockwise."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.5, 4.5), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axes: Any = figure.add_subplot(projection="polar")
    axes.set_theta_zero_location("N")
    axes.set_theta_direction(-1)
    heading, gain = pattern.table()
    closed = np.append(heading, 360.0)
    gain, half = np.append(gain, gain[0]), BAND_SIGMA * pattern.gain_sigma(closed)
    axes.plot(np.radians(closed), gain, color=MODEL)
    axes.fill_between(np.radians(closed), gain - half, gain + half, color=MODEL, alpha=0.15, linewidth=0)
    axes.set_title(f"{pattern.name}, gain in dB")
    return figure


def profile_figure(profiles: Sequence[Profile]) -> "Figure":
    """How fast the fit gets worse as each parameter moves away; 1 is the end of the 95 % interval."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 2.4), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    for number, one in enumerate(profiles):
        axes = figure.add_subplot(1, len(profiles), number + 1)
        axes.plot(one.value, one.drop, color=MEASURED)
        axes.axhline(1.0, color=MODEL, linewidth=0.8, linestyle=":")
        unit = "" if one.name == "path_loss_exponent" else " (dB)" if one.name == "sigma_db" else " (dBm)"
        axes.set(xlabel=one.name.removesuffix("_dbm").removesuffix("_db") + unit, ylim=(0.0, 1.2))
        axes.locator_params(axis="x", nbins=4)
    return figure


def save_plot(result: FitResult, path: Path) -> None:
    """Write `fit_figure` to a file, as SVG or PDF where it is called so, else as PNG."""
    from fieldkit.files import write_whole

    stream = BytesIO()
    kind = path.suffix.lower().removeprefix(".")
    fit_figure(result).savefig(stream, format=kind if kind in ("svg", "pdf") else "png")
    write_whole(path, stream.getvalue())


def _counted(result: FitResult) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Distinct (distance, reading) with how often: a million readings are still a small picture.

    Readings are shown as an antenna that is the same all round would have given them.
    """
    r = result.readings
    level = r.rss_dbm if r.gain_db is None else r.rss_dbm - r.gain_db
    pairs = np.column_stack([r.distance_m, level])[~r.missed]
    distinct, count = np.unique(pairs, axis=0, return_counts=True)
    step = max(1, len(distinct) // _MOST_POINTS)
    return distinct[::step, 0], distinct[::step, 1], count[::step].astype(float)


def _log_distance(axes: Any) -> None:
    """A logarithmic axis labelled 0.2, 0.5, 1, 2 ..., not in powers of ten."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def _figure(width: float, height: float) -> "tuple[Figure, Any]":
    # The object interface: pyplot would start a window system.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.add_subplot()
