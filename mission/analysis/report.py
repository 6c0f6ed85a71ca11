"""One offline HTML page on a recorded mission, for people who were not there."""

from pathlib import Path
from typing import Any

import jinja2
import numpy as np

from fieldkit import __version__
from fieldkit.files import write_whole
from mission.analysis.story import Story, read_story


def write_report(log: Path, out: Path) -> dict[str, Any]:
    """Write the page on recording `log` to `out`, whole or not at all; its key figures."""
    from mission.analysis import plots

    story = read_story(log)
    stretches = purposes(story)
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
    )
    page = environment.get_template("report.html.j2").render(
        name=story.mission.file.name,
        version=__version__,
        log=log.name,
        story=story,
        summary=summarise(story),
        sources=[_row(story, source) for source in story.final],
        robots=[_robot(story, robot, stretches) for robot in story.tracks],
        stretches=stretches,
        map=plots.svg(plots.field_map(story)),
        probability=plots.svg(plots.probability_over_time(story)),
        heard=plots.svg(plots.detections_over_time(story)),
        use=plots.svg(plots.use_of_robots(story, stretches)),
    )
    write_whole(out, page)
    return {
        "recording": str(log),
        "complete": story.recording.complete,
        "missing": story.recording.missing,
        "duration_s": round(story.duration_s, 1),
        "detections": len(story.detections),
        "found": len(story.found),
    }


def summarise(story: Story) -> list[str]:
    """What happened, in sentences."""
    sentences = []
    if story.recording.missing:
        sentences.append(f"The recording is not whole: {story.recording.missing}.")
    heard = len(story.detections)
    if not heard:
        sentences.append(f"In {story.duration_s:.0f} s nothing was heard, so nothing was found.")
    else:
        sentences.append(
            f"In {story.duration_s:.0f} s the team heard {heard} transmission{'s' * (heard > 1)} and found "
            f"{len(story.found)} source{'s' * (len(story.found) != 1)}."
        )
    for source in story.found:
        sigma = float(np.sqrt(np.trace(source.cov_m2) / 2))
        sentences.append(
            f"Source {source.ident} is at {source.east_m:.2f} m east, {source.north_m:.2f} m north (standard deviation "
            f"{sigma:.2f} m), with probability {source.p_here:.2f} within one cell of it, "
            f"from {source.receptions:.0f} receptions."
        )
    for source in story.final:
        if source.state == "doubtful":
            sentences.append(f"No position is claimed for source {source.ident}: {source.note}.")
        elif source.state == "candidate":
            sentences.append(
                f"Candidate {source.ident} near {source.east_m:.1f} m east, {source.north_m:.1f} m north "
                "is not resolved "
                f"({source.receptions:.1f} receptions, probability {source.p_here:.2f})."
            )
    if story.left:
        sentences.append(
            f"The probability that a source sending {story.mission.kernel.engine.reference_rate_hz:g} times a second "
            "or "
            f"more was still unfound at the end is {story.left[-1][1]:.3f}."
        )
    if story.result is not None:
        sentences.append(f"The mission ended because {story.result['end_reason']}.")
    held = sorted({hold.robot for _, hold in story.holds})
    if held:
        sentences.append(f"Safety held {', '.join(held)} ({len(story.holds)} orders).")
    return sentences


def purposes(story: Story) -> list[tuple[str, float, float, str]]:
    """(robot, from s, to s, purpose), from the plans, cut by holds."""
    rows: list[tuple[str, float, float, str]] = []
    for robot in story.tracks:
        marks = [(t, plan.purpose[robot]) for t, plan in story.plans if robot in plan.purpose]
        marks += [(t, "held") for t, hold in story.holds if hold.robot == robot]
        marks.sort(key=lambda mark: mark[0])
        for index, (t, purpose) in enumerate(marks):
            end = marks[index + 1][0] if index + 1 < len(marks) else story.duration_s
            if rows and rows[-1][0] == robot and rows[-1][3] == purpose:
                rows[-1] = (robot, rows[-1][1], end, purpose)
            else:
                rows.append((robot, t, end, purpose))
    return rows


def _row(story: Story, source: Any) -> dict[str, Any]:
    lat, lon, _ = story.mission.frame.to_geodetic(source.east_m, source.north_m)
    nearest = min(
        (float(np.hypot(source.east_m - t["east_m"], source.north_m - t["north_m"])) for t in story.truth),
        default=None,
    )
    return {
        "source": source,
        "sigma_m": float(np.sqrt(np.trace(source.cov_m2) / 2)),
        "lat_deg": lat,
        "lon_deg": lon,
        "error_m": nearest,
    }


def _robot(story: Story, robot: str, stretches: list[tuple[str, float, float, str]]) -> dict[str, Any]:
    track = story.tracks[robot]
    steps = np.hypot(np.diff(track[:, 1]), np.diff(track[:, 2]))
    spent: dict[str, float] = {}
    for name, start_s, end_s, purpose in stretches:
        if name == robot:
            kind = purpose.split(" ", 1)[0]
            spent[kind] = spent.get(kind, 0.0) + end_s - start_s
    readings = sum(
        robot in d.robots and not np.isnan(d.rss_dbm[d.robots.index(robot)]) for _, d in story.detections
    )
    return {"name": robot, "distance_m": float(steps.sum()), "readings": int(readings), "spent_s": spent}
