"""The report's pictures, as inline SVG: a page that opens offline and prints sharp."""

import io
from collections.abc import Sequence

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from fieldkit.messages import SourceEstimate
from mission.analysis.story import Story

ROBOT_COLOURS = ("#0072b2", "#56b4e9", "#009e73", "#66c2a5", "#cc79a7", "#e7a6c9", "#8c6d31", "#bd9e39")
"""Neighbours share a hue: robots of a pair."""
FOUND, CANDIDATE, DOUBTFUL, TRUTH = "#d62728", "#ff7f0e", "#7f7f7f", "#000000"


def svg(figure: Figure) -> str:
    """The figure as an `<svg>` element."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", bbox_inches="tight")
    plt.close(figure)
    text = buffer.getvalue()
    return text[text.index("<svg") :]


def field_map(story: Story) -> Figure:
    """Belief, tracks, sources with their 90 % ellipse, and the truth where it is known."""
    field = story.mission.file.field
    figure, axes = plt.subplots(figsize=(7.2, 6.4))
    if story.belief is not None:
        # Cells that are likely differ by orders of magnitude from those that are merely unsearched.
        shown = axes.imshow(
            np.log10(np.maximum(story.belief.values, 1e-5)), origin="lower", cmap="Greys", vmin=-5, vmax=0,
            extent=(0, field.size_east_m, 0, field.size_north_m), aspect="equal", interpolation="nearest",
        )  # fmt: skip
        bar = figure.colorbar(shown, ax=axes, shrink=0.8, label="probability that the cell holds a source")
        bar.set_ticks([-5, -4, -3, -2, -1, 0], labels=["≤ 0.00001", "0.0001", "0.001", "0.01", "0.1", "1"])
    for index, (robot, track) in enumerate(story.tracks.items()):
        colour = ROBOT_COLOURS[index % len(ROBOT_COLOURS)]
        axes.plot(track[:, 1], track[:, 2], lw=0.6, color=colour, alpha=0.8, label=robot)
        axes.plot(track[-1, 1], track[-1, 2], "o", ms=5, color=colour)
    for source in story.final:
        _draw_source(axes, source)
    for index, truth in enumerate(story.truth):
        axes.plot(
            truth["east_m"],
            truth["north_m"],
            "x",
            ms=9,
            mew=2,
            color=TRUTH,
            label="" if index else "true source",
        )
    axes.set(xlim=(0, field.size_east_m), ylim=(0, field.size_north_m), xlabel="east, m", ylabel="north, m")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.1), ncol=5, frameon=False, fontsize=8)
    return figure


def _draw_source(axes: plt.Axes, source: SourceEstimate) -> None:
    colour = {"found": FOUND, "candidate": CANDIDATE, "doubtful": DOUBTFUL, "removed": DOUBTFUL}[source.state]
    values, vectors = np.linalg.eigh(source.cov_m2)
    angle = float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])))
    spread = 2 * 2.146 * np.sqrt(np.maximum(values, 1e-6))  # 90 % of a plane normal lies within 2.146 sigma
    axes.add_patch(
        Ellipse(
            (source.east_m, source.north_m),
            spread[1],
            spread[0],
            angle=angle,
            fill=False,
            color=colour,
            lw=1.5,
        )
    )
    axes.plot(source.east_m, source.north_m, "+", ms=8, mew=1.5, color=colour)
    axes.annotate(
        f"{source.ident}",
        (source.east_m, source.north_m),
        xytext=(6, 6),
        textcoords="offset points",
        color=colour,
    )


def probability_over_time(story: Story) -> Figure:
    """P(within one cell) of each source that ended as one, and the probability that one is left."""
    figure, axes = plt.subplots(figsize=(8.4, 2.8))
    for source in story.final:
        points = [
            (t, s.p_here) for t, all_then in story.estimates for s in all_then if s.ident == source.ident
        ]
        if points:
            t, p = zip(*points, strict=True)
            axes.step(t, p, where="post", label=f"source {source.ident}")
    if story.left:
        t, p = zip(*story.left, strict=True)
        axes.plot(t, p, color="black", ls=":", label="one is left")
    axes.axhline(story.mission.kernel.engine.found_probability, color="grey", lw=0.8, ls="--")
    axes.set(
        xlim=(0, max(story.duration_s, 1.0)), ylim=(0, 1.02), xlabel="mission time, s", ylabel="probability"
    )
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False, fontsize=8)
    return figure


def detections_over_time(story: Story) -> Figure:
    """Every reading of every transmission, by robot."""
    figure, axes = plt.subplots(figsize=(8.4, 2.8))
    for index, robot in enumerate(story.tracks):
        points = [
            (t, float(detection.rss_dbm[detection.robots.index(robot)]))
            for t, detection in story.detections
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
    axes.axhline(story.mission.kernel.engine.antenna.threshold_dbm, color="grey", lw=0.8, ls="--")
    axes.set(xlim=(0, max(story.duration_s, 1.0)), xlabel="mission time, s", ylabel="RSSI, dBm")
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False, fontsize=8)
    return figure


def use_of_robots(story: Story, stretches: Sequence[tuple[str, float, float, str]]) -> Figure:
    """Who was on what, when: searching, resolving a candidate, on a ridge, held."""
    robots = list(story.tracks)
    figure, axes = plt.subplots(figsize=(8.4, 0.5 + 0.35 * max(1, len(robots))))
    kinds = sorted({_kind(purpose) for _, _, _, purpose in stretches})
    palette = dict(zip(kinds, [plt.get_cmap("tab10")(k) for k in range(10)], strict=False))
    for robot, start_s, end_s, purpose in stretches:
        axes.barh(
            robots.index(robot), end_s - start_s, left=start_s, color=palette[_kind(purpose)], height=0.7
        )
    for kind in kinds:
        axes.barh(0, 0, color=palette[kind], label=kind)
    axes.set_yticks(range(len(robots)), labels=robots)
    axes.set(xlim=(0, max(story.duration_s, 1.0)), xlabel="mission time, s")
    if kinds:
        axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False, fontsize=8)
    return figure


def _kind(purpose: str) -> str:
    return purpose.split(" ", 1)[0].rstrip(":")
