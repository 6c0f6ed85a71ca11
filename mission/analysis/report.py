"""One offline HTML page on a recorded mission, for people who were not there."""

from pathlib import Path
from typing import Any

import jinja2
import numpy as np

from fieldkit import __version__
from fieldkit.files import write_whole
from fieldkit.messages import SourceEstimate
from mission.analysis import words
from mission.analysis.coverage import Coverage, coverage
from mission.analysis.faults import faults
from mission.analysis.history import Story, read_story
from mission.analysis.refine import Fit, Refined, model_fit, refine
from mission.analysis.use import stretches, use

FEW_RECEPTIONS = 3.0
"""A source with fewer is not refined: three numbers cannot be told from so little."""


def write_report(log: Path, out: Path) -> dict[str, Any]:
    """Write the page on recording `log` to `out`, whole or not at all; its key figures."""
    from mission.analysis import plots

    story = read_story(log)
    rows = stretches(story)
    covered = searched(story)
    refined = refinements(story)
    kernel = story.mission.kernel.engine
    fit = model_fit([d for _, d in story.detections], refined, kernel.antenna, kernel.pose_sigma_m)
    by_ident = {each.ident: each for each in refined}
    wrong = faults(story)
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
        duration=words.minutes(story.duration_s),
        cards=_cards(story, covered),
        found=words.found(story),
        silent=words.silent(story, covered),
        fit_words=words.fit(fit),
        ending=words.ending(story),
        sources=[_row(story, source, by_ident.get(source.ident)) for source in _shown(story)],
        uses=use(story, rows),
        percent=words.percent,
        faults=wrong,
        notes=[note for note in story.notes if note[1] not in ("warning", "error")],
        stretches=rows,
        map=plots.svg(plots.field_map(story)),
        searched=plots.svg(plots.searched_map(story, covered)),
        residuals=plots.svg(plots.residuals(fit)) if fit.residual_db.size >= 10 else "",
        fits=_fit_by_robot(story, fit),
        probability=plots.svg(plots.probability_over_time(story)),
        heard=plots.svg(plots.detections_over_time(story)),
        use=plots.svg(plots.use_of_robots(story, rows)),
    )
    write_whole(out, page)
    return {
        "recording": str(log),
        "complete": story.recording.complete,
        "missing": story.recording.missing,
        "duration_s": round(story.duration_s, 1),
        "detections": len(story.detections),
        "found": len(story.found),
        "searched_share": round(covered.searched_share, 4),
        "probability_left": round(story.left[-1][1], 4) if story.left else None,
        "faults": len(wrong),
        "fit": {
            "readings": int(fit.residual_db.size),
            "bias_db": _plain(fit.bias_db),
            "spread_db": _plain(fit.spread_db),
            "promised_db": _plain(fit.promised_db),
        },
        "refined": [
            {
                "ident": r.ident,
                "east_m": round(r.east_m, 3),
                "north_m": round(r.north_m, 3),
                "sigma_m": _plain(r.sigma_m),
                "power_db": round(r.power_db, 2),
                "receptions": round(r.receptions, 1),
            }
            for r in refined
        ],
    }


def searched(story: Story) -> Coverage:
    """What was searched in a mission."""
    engine, field = story.mission.kernel.engine, story.mission.file.field
    return coverage(
        story.tracks,
        {robot: story.down(robot) for robot in story.tracks},
        engine.antenna,
        engine.power_levels_db,
        (field.size_east_m, field.size_north_m),
        engine.reference_rate_hz,
        story.duration_s,
    )


def refinements(story: Story) -> list[Refined]:
    """The mission's sources refined: those found, and candidates with enough receptions. Doubtful ones are left out."""
    engine, field = story.mission.kernel.engine, story.mission.file.field
    wanted = [
        source
        for source in story.final
        if source.state == "found"
        or (source.state == "candidate" and source.p_exists > 0.5 and source.receptions >= FEW_RECEPTIONS)
    ]
    return refine(
        [detection for _, detection in story.detections],
        wanted,
        engine.antenna,
        size_m=(field.size_east_m, field.size_north_m),
        levels_db=engine.power_levels_db,
        place_sigma_m=engine.pose_sigma_m,
    )


def _shown(story: Story) -> list[SourceEstimate]:
    """Sources worth a word: all but candidates that are probably none."""
    return [source for source in story.final if source.state != "candidate" or source.p_exists > 0.5]


def _cards(story: Story, covered: Coverage) -> list[tuple[str, str]]:
    """The key figures, each with its unit or meaning."""
    cards = [
        (str(len(story.found)), "found" if len(story.found) != 1 else "source found"),
        (str(len(story.detections)), "transmissions heard"),
        (words.percent(covered.searched_share), "of the field searched"),
    ]
    if story.left:
        cards.append((words.percent(story.left[-1][1]), "that one is left"))
    return [*cards, (words.minutes(story.duration_s), "of mission")]


def _row(story: Story, source: SourceEstimate, refined: Refined | None) -> dict[str, Any]:
    from mission.analysis import plots

    lat, lon, _ = story.mission.frame.to_geodetic(source.east_m, source.north_m)
    row: dict[str, Any] = {
        "source": source,
        "sigma_m": float(np.sqrt(np.trace(source.cov_m2) / 2)),
        "lat_deg": lat,
        "lon_deg": lon,
        "error_m": _off(story, source.east_m, source.north_m),
        "refined": refined,
        "receptions": _receptions(story, refined),
        "map": plots.svg(plots.source_map(story, source, refined)) if source.state != "doubtful" else "",
    }
    if refined is not None:
        lat, lon, _ = story.mission.frame.to_geodetic(refined.east_m, refined.north_m)
        row |= {
            "refined_lat_deg": lat,
            "refined_lon_deg": lon,
            "refined_error_m": _off(story, refined.east_m, refined.north_m),
        }
    return row


def _off(story: Story, east_m: float, north_m: float) -> float | None:
    """Distance to the nearest true source; None where the truth is not known."""
    return min(
        (float(np.hypot(east_m - t["east_m"], north_m - t["north_m"])) for t in story.truth), default=None
    )


def _receptions(story: Story, refined: Refined | None) -> list[dict[str, Any]]:
    """The transmissions that are this source's with more than even odds: when, who heard it how strongly."""
    if refined is None:
        return []
    rows = []
    for (t_s, detection), share in zip(story.detections, refined.share, strict=True):
        if share > 0.5:
            heard = [
                f"{robot} {'≥ ' if detection.saturated[k] else ''}{detection.rss_dbm[k]:.0f}"
                for k, robot in enumerate(detection.robots)
                if not np.isnan(detection.rss_dbm[k])
            ]
            silent = [r for k, r in enumerate(detection.robots) if np.isnan(detection.rss_dbm[k])]
            rows.append(
                {"t_s": t_s, "share": float(share), "heard": ", ".join(heard), "silent": ", ".join(silent)}
            )
    return rows


def _fit_by_robot(story: Story, fit: Fit) -> list[dict[str, Any]]:
    """The model fit of each robot's own readings: one radio that is off shows here."""
    rows = []
    for robot in story.tracks:
        mine = fit.residual_db[fit.robot == robot]
        if mine.size >= 5:
            rows.append(
                {
                    "robot": robot,
                    "n": int(mine.size),
                    "bias_db": float(mine.mean()),
                    "spread_db": float(mine.std(ddof=1)),
                }
            )
    return rows


def _plain(value: float) -> float | None:
    return round(value, 3) if np.isfinite(value) else None
