"""The report's pictures, as inline SVG: a page that opens offline and prints sharp."""

import io
from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from matplotlib.patheffects import withStroke
from matplotlib.transforms import Affine2D

from fieldkit.look import CANDIDATE, FOUND, INCONSISTENT, ROBOT_COLOURS, TRUTH
from fieldkit.messages import SourceEstimate
from fieldkit.settings import ELLIPSE_90
from mission.analysis.coverage import SEARCHED, Coverage
from mission.analysis.history import History
from mission.analysis.refine import Fit, Refined
from mission.analysis.use import Stretch, kind
from mission.maps.background import Background, background_or_none

SEEN_THROUGH = 0.8
"""How opaque a sure cell is over a picture of the ground."""
BEYOND = 0.03
"""Share of the field that its map shows beyond each border."""


def _subplots(*, figsize: tuple[float, float]) -> tuple[Figure, Axes]:
    """A figure of its own: pyplot would keep each one, and choose a window system."""
    figure = Figure(figsize=figsize)
    return figure, figure.subplots()


def field_map(history: History) -> Figure:
    """Belief, tracks, sources with their 90 % ellipse, and the truth where known; over a picture of the ground."""
    field = history.mission.file.field
    figure, axes = _subplots(figsize=(7.2, 6.4))
    background = background_or_none(history.mission)
    if background is not None:
        draw_ground(axes, background)
    if history.belief is not None:
        # Cells that are likely differ by orders of magnitude from those that are merely unsearched.
        logs = np.log10(np.maximum(history.belief.values, 1e-5))
        shown = axes.imshow(
            logs, origin="lower", cmap="Greys" if background is None else "YlOrRd", vmin=-5, vmax=0,
            alpha=None if background is None else SEEN_THROUGH * (logs + 5.0) / 5.0,
            extent=(0, field.size_east_m, 0, field.size_north_m), aspect="equal", interpolation="nearest",
        )  # fmt: skip
        bar = figure.colorbar(shown, ax=axes, shrink=0.8, label="probability that the cell holds a source")
        bar.set_ticks([-5, -4, -3, -2, -1, 0], labels=["≤ 0.00001", "0.0001", "0.001", "0.01", "0.1", "1"])
    for index, (robot, track) in enumerate(history.tracks.items()):
        colour = ROBOT_COLOURS[index % len(ROBOT_COLOURS)]
        axes.plot(track[:, 1], track[:, 2], lw=0.7, color=colour, alpha=0.6, label=robot)
        axes.plot(track[-1, 1], track[-1, 2], "o", ms=5, color=colour)
    for source in history.final:
        _draw_source(axes, source)
    for index, truth in enumerate(history.truth):
        axes.plot(
            truth["east_m"],
            truth["north_m"],
            "x",
            ms=9,
            mew=2,
            color=TRUTH,
            label="" if index else "true source",
        )
    # A little beyond the border: what is found on it is whole.
    beyond_m = BEYOND * max(field.size_east_m, field.size_north_m)
    axes.set(xlim=(-beyond_m, field.size_east_m + beyond_m), ylim=(-beyond_m, field.size_north_m + beyond_m))
    axes.set(xlabel="east, m", ylabel="north, m")
    legend(axes, loc="upper center", bbox_to_anchor=(0.5, -0.1), ncol=5, frameon=False, fontsize=8)
    return figure


def legend(axes: Axes, **how: Any) -> None:
    """What the colours mean; nothing where nothing has a name, of which matplotlib would warn whoever reads along."""
    if axes.get_legend_handles_labels()[0]:
        axes.legend(**how)


def draw_ground(axes: Axes, background: Background) -> None:
    """The pictures of the ground, each by its affine map from pixels to metres."""
    from PIL import Image

    for picture in background.smaller():
        with Image.open(io.BytesIO(picture.data)) as image:
            pixels = np.asarray(image.convert("RGB"))
        height, width = pixels.shape[:2]
        nw, ne, sw = (np.array(corner) for corner in picture.corners_m)
        right, down = (ne - nw) / width, (sw - nw) / height
        matrix = np.array([[right[0], down[0], nw[0]], [right[1], down[1], nw[1]], [0.0, 0.0, 1.0]])
        shown = axes.imshow(pixels, extent=(0, width, height, 0), aspect="equal", zorder=-1)
        shown.set_transform(Affine2D(matrix) + axes.transData)
    if background.credit:
        axes.annotate(
            background.credit, (1, 0), xycoords="axes fraction", ha="right", va="bottom", fontsize=6, color=TRUTH,
            path_effects=[withStroke(linewidth=2, foreground="white")],
        )  # fmt: skip


def _draw_source(axes: Axes, source: SourceEstimate) -> None:
    colour = {"found": FOUND, "candidate": CANDIDATE}.get(source.state, INCONSISTENT)
    axes.add_patch(ellipse(source.east_m, source.north_m, source.cov_m2, colour, "-"))
    axes.plot(source.east_m, source.north_m, "+", ms=10, mew=4, color="white", zorder=4)
    axes.plot(source.east_m, source.north_m, "+", ms=9, mew=2, color=colour, zorder=5)
    axes.annotate(
        f"{source.ident}",
        (source.east_m, source.north_m),
        xytext=(6, 6),
        textcoords="offset points",
        color=colour,
        fontweight="bold",
        zorder=6,
        path_effects=[withStroke(linewidth=2.5, foreground="white")],
    )


def probability_over_time(history: History) -> Figure:
    """P(within one cell) of each source that ended as one, and the probability that one is left."""
    figure, axes = _subplots(figsize=(8.4, 2.8))
    draw_probability(axes, history)
    return figure


def draw_probability(axes: Axes, history: History) -> None:
    """See `probability_over_time`."""
    for source in history.final:
        points = [
            (t, s.p_here) for t, all_then in history.estimates for s in all_then if s.ident == source.ident
        ]
        if points:
            t, p = zip(*points, strict=True)
            axes.step(t, p, where="post", label=f"source {source.ident}")
    if history.left:
        t, p = zip(*history.left, strict=True)
        axes.plot(t, p, color="black", ls=":", label="one still hidden")
    axes.axhline(history.mission.kernel.engine.found_probability, color="grey", lw=0.8, ls="--")
    axes.set(
        xlim=(0, max(history.duration_s, 1.0)), ylim=(0, 1.02), xlabel="mission time, s", ylabel="probability"
    )
    legend(axes, loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False, fontsize=8)


def detections_over_time(history: History) -> Figure:
    """Every reading of every transmission, by robot."""
    figure, axes = _subplots(figsize=(8.4, 2.8))
    draw_detections(axes, history)
    return figure


def draw_detections(axes: Axes, history: History) -> None:
    """See `detections_over_time`."""
    for index, robot in enumerate(history.tracks):
        points = [
            (t, float(detection.rss_dbm[detection.robots.index(robot)]))
            for t, detection in history.detections
            if robot in detection.robots and not np.isnan(detection.rss_dbm[detection.robots.index(robot)])
        ]
        if points:
            axes.plot(
                *zip(*points, strict=True),
                "o",
                ms=4,
                color=ROBOT_COLOURS[index % len(ROBOT_COLOURS)],
                label=robot,
            )
    axes.axhline(history.mission.kernel.engine.antenna.threshold_dbm, color="grey", lw=0.8, ls="--")
    axes.set(xlim=(0, max(history.duration_s, 1.0)), xlabel="mission time, s", ylabel="RSSI, dBm")
    legend(axes, loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False, fontsize=8)


def use_of_robots(history: History, rows: Sequence[Stretch]) -> Figure:
    """Who was on what, when: searching, on a candidate, on a ridge, held."""
    robots = list(history.tracks)
    figure, axes = _subplots(figsize=(8.4, 0.5 + 0.35 * max(1, len(robots))))
    kinds = sorted({kind(purpose) for *_, purpose in rows})
    looks = _looks(kinds)
    for robot, start_s, end_s, purpose in rows:
        axes.barh(
            robots.index(robot),
            end_s - start_s,
            left=start_s,
            height=0.7,
            **looks[kind(purpose)],
        )
    for each in kinds:
        axes.barh(0, 0, label=each, **looks[each])
    axes.set_yticks(range(len(robots)), labels=robots)
    axes.set(xlim=(0, max(history.duration_s, 1.0)), xlabel="mission time, s")
    if kinds:
        legend(axes, loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False, fontsize=8)
    return figure


def _looks(kinds: Sequence[str]) -> dict[str, dict[str, Any]]:
    """What a bar of each kind looks like: from dark to light, so that they differ on paper in black and white too."""
    steady = [each for each in kinds if each != "held"]
    shades = matplotlib.colormaps["cividis"](np.linspace(0.15, 0.9, max(1, len(steady))))
    looks: dict[str, dict[str, Any]] = {
        each: {"color": shade} for each, shade in zip(steady, shades, strict=False)
    }
    return looks | {"held": {"color": "white", "hatch": "////", "edgecolor": "black", "linewidth": 0.5}}


def searched_map(history: History, covered: Coverage) -> Figure:
    """Where a source would have been heard, had there been one."""
    east_m, north_m = covered.size_m
    figure, axes = _subplots(figsize=(4.6, 4.2))
    shown = axes.imshow(
        covered.heard,
        origin="lower",
        cmap="YlGn",
        vmin=0,
        vmax=1,
        extent=(0, east_m, 0, north_m),
        aspect="equal",
    )
    if 0.0 < covered.searched_share < 1.0:
        grid = (
            np.linspace(0.0, east_m, covered.heard.shape[1]),
            np.linspace(0.0, north_m, covered.heard.shape[0]),
        )
        axes.contour(*grid, covered.heard, levels=[SEARCHED], colors="black", linewidths=1.4)
    figure.colorbar(shown, ax=axes, shrink=0.8, label="probability of having heard a source there")
    axes.set(xlabel="east, m", ylabel="north, m")
    return figure


def source_map(history: History, source: SourceEstimate, refined: Refined | None) -> Figure:
    """The surroundings of one source: belief, its receptions by strength, estimate, refinement, truth."""
    half = _surroundings_m(history, source, refined)
    figure, axes = _subplots(figsize=(4.4, 4.0))
    field = history.mission.file.field
    if history.belief is not None:
        axes.imshow(
            np.log10(np.maximum(history.belief.values, 1e-5)), origin="lower", cmap="Greys", vmin=-5, vmax=0,
            extent=(0, field.size_east_m, 0, field.size_north_m), aspect="equal", interpolation="nearest",
        )  # fmt: skip
    if refined is not None:
        weight = refined.share
        places = [
            (float(e), float(n), float(z))
            for (_, d), w in zip(history.detections, weight, strict=True)
            if w > 0.5
            for (e, n), z in zip(d.position_m, d.rss_dbm, strict=True)
            if not np.isnan(z)
        ]
        if places:
            e, n, z = zip(*places, strict=True)
            dots = axes.scatter(e, n, c=z, s=16, cmap="viridis", edgecolors="white", linewidths=0.3)
            figure.colorbar(dots, ax=axes, shrink=0.8, label="received there, dBm")
        for ring in refined.region:
            axes.plot(*zip(*ring, strict=True), color="#1f77b4", lw=1.2)
        if not refined.region and np.all(np.isfinite(refined.cov_m2)):
            axes.add_patch(ellipse(refined.east_m, refined.north_m, refined.cov_m2, "#1f77b4", "-"))
        axes.plot(refined.east_m, refined.north_m, "x", ms=8, mew=1.8, color="#1f77b4", label="refined")
    _draw_source(axes, source)
    for index, truth in enumerate(history.truth):
        axes.plot(truth["east_m"], truth["north_m"], "k*", ms=9, label="" if index else "true")
    axes.set(
        xlim=(source.east_m - half, source.east_m + half), ylim=(source.north_m - half, source.north_m + half),
        xlabel="east, m", ylabel="north, m", aspect="equal",
    )  # fmt: skip
    return figure


def _surroundings_m(history: History, source: SourceEstimate, refined: Refined | None) -> float:
    """How far around a source to look: its ellipse, some cells, and most of the places it was heard from."""
    sigma = float(np.sqrt(max(np.trace(source.cov_m2) / 2, 0.0)))
    reach = [5.0 * sigma, 5.0 * history.mission.kernel.engine.grid.cell_m]
    if refined is not None:
        far = [
            float(np.hypot(e - source.east_m, n - source.north_m))
            for (_, d), share in zip(history.detections, refined.share, strict=True)
            if share > 0.5
            for (e, n), z in zip(d.position_m, d.rss_dbm, strict=True)
            if not np.isnan(z)
        ]
        reach += [1.1 * float(np.quantile(far, 0.8))] if far else []
    return max(reach)


def residuals(fit: Fit) -> Figure:
    """How readings lie around the prediction, with the curve the antenna file promises."""
    figure, axes = _subplots(figsize=(4.6, 3.0))
    reach = max(12.0, float(np.abs(fit.residual_db).max()) + 1.0)
    bins = np.arange(-np.ceil(reach), np.ceil(reach) + 1.0, 1.0)
    axes.hist(fit.residual_db, bins=bins.tolist(), color="#9ecae1", density=True, label="readings")
    x = np.linspace(-reach, reach, 300)
    sigma = fit.promised_db
    axes.plot(
        x, np.exp(-0.5 * (x / sigma) ** 2) / (sigma * np.sqrt(2 * np.pi)), color="#08519c", label="promised"
    )
    axes.set(xlabel="reading minus prediction, dB", yticks=[])
    legend(axes, frameon=False, fontsize=8)
    return figure


def ellipse(east_m: float, north_m: float, cov_m2: np.ndarray, colour: str, style: str) -> Ellipse:
    """The outline that holds 90 % of a normal posterior."""
    values, vectors = np.linalg.eigh(cov_m2)
    angle = float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])))
    spread = 2 * ELLIPSE_90 * np.sqrt(np.maximum(values, 1e-6))
    return Ellipse(
        (east_m, north_m), spread[1], spread[0], angle=angle, fill=False, color=colour, lw=1.5, ls=style
    )


def found_by_time(rows: Sequence[dict[str, Any]], by: str) -> Figure:
    """Of all sources of a group's missions, the share found (for good) by each time."""
    figure, axes = _subplots(figsize=(8.4, 3.2))
    groups = sorted({row[by] for row in rows}, key=str)
    last_s = max((row["duration_s"] for row in rows), default=1.0)
    for index, group in enumerate(groups):
        sources = [s for row in rows if row[by] == group for s in row["sources"]]
        times = sorted(s["found_after_s"] for s in sources if s["found_after_s"] is not None)
        share = np.arange(1, len(times) + 1) / max(len(sources), 1)
        axes.step(
            [0.0, *times, last_s], [0.0, *share, share[-1] if times else 0.0], where="post",
            color=f"C{index % 10}", label=f"{group} ({len(sources)} sources)",
        )  # fmt: skip
    axes.set(
        xlim=(0, max(last_s, 1.0)), ylim=(0, 1.02), xlabel="mission time, s", ylabel="share of sources found"
    )
    legend(axes, loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False, fontsize=8)
    return figure


def errors_by_group(rows: Sequence[dict[str, Any]], by: str) -> Figure:
    """Distance of each find to its true source, a dot each, with the median."""
    groups = sorted({row[by] for row in rows}, key=str)
    figure, axes = _subplots(figsize=(8.4, 0.9 + 0.45 * len(groups)))
    for index, group in enumerate(groups):
        errors = [
            s["error_m"] for r in rows if r[by] == group for s in r["sources"] if s["error_m"] is not None
        ]
        offset = np.linspace(-0.18, 0.18, len(errors)) if len(errors) > 1 else np.zeros(len(errors))
        axes.plot(errors, index + offset, "o", ms=4, alpha=0.6, color=f"C{index % 10}")
        if errors:
            axes.plot([float(np.median(errors))] * 2, [index - 0.3, index + 0.3], color="black", lw=1.5)
    axes.set_yticks(range(len(groups)), labels=[str(group) for group in groups])
    axes.set(xlabel="distance to the true source, m", ylim=(-0.6, len(groups) - 0.4))
    axes.set_xlim(left=0.0)
    return figure
