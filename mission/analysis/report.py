"""One offline HTML page on a recorded mission, for people who were not there."""

from pathlib import Path
from typing import Any

import jinja2
import numpy as np

from fieldkit import __version__
from fieldkit.coordinates import coordinates
from fieldkit.files import write_whole
from fieldkit.look import paper_css, svg
from fieldkit.messages import SourceEstimate
from fieldkit.recording.reader import Recording
from fieldkit.settings import ELLIPSE_90
from mission.analysis import words
from mission.analysis.coverage import Coverage, coverage
from mission.analysis.faults import faults
from mission.analysis.history import History, read_history
from mission.analysis.next_steps import next_steps
from mission.analysis.placed import placed
from mission.analysis.refine import Fit, Refined, model_fit, refine
from mission.analysis.use import stretches, use

FEW_RECEPTIONS = 3.0
"""A source with fewer is not refined: three numbers cannot be estimated from so little."""


def write_report(log: Path | Recording, out: Path, interactive: str = "") -> dict[str, Any]:
    """Write the page on a recording, opened already or not, to `out`, whole or not at all; its key figures.

    `interactive`: the mission's page as a piece of HTML, to stand in the report.
    """
    history = read_history(log)
    covered = searched(history)
    refined = refinements(history)
    kernel = history.mission.kernel.engine
    fit = model_fit([d for _, d in history.detections], refined, kernel.antenna, kernel.pose_sigma_m)
    write_whole(out, _page(history.path.name, history, covered, refined, fit, interactive))
    return {
        "recording": str(history.path),
        "complete": history.recording.complete,
        "missing": history.recording.missing,
        "duration_s": round(history.duration_s, 1),
        "detections": len(history.detections),
        "found": len(history.found),
        "searched_share": round(covered.searched_share, 4),
        "probability_left": round(history.left[-1][1], 4) if history.left else None,
        "faults": len(faults(history)),
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


def _page(
    name: str, history: History, covered: Coverage, refined: list[Refined], fit: Fit, interactive: str
) -> str:
    """The page on the recording of this name."""
    from mission.analysis import plots

    rows = stretches(history)
    by_ident = {each.ident: each for each in refined}
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
    )
    return environment.get_template("report.html.j2").render(
        name=history.mission.file.name,
        version=__version__,
        css=paper_css(),
        interactive=interactive,
        log=name,
        history=history,
        duration=words.minutes(history.duration_s),
        cards=_cards(history, covered),
        places=[_place(history, source, by_ident.get(source.ident)) for source in _shown(history)],
        steps=next_steps(history, covered, fit),
        found=words.found(history),
        within=words.found_within(history),
        silent=words.silent(history, covered),
        fit_words=words.fit(fit),
        ending=words.ending(history),
        sources=[_row(history, source, by_ident.get(source.ident)) for source in _shown(history)],
        said=_said(history),
        uses=use(history, rows),
        percent=words.percent,
        faults=faults(history),
        notes=[note for note in history.notes if note[1] not in ("warning", "error")],
        stretches=rows,
        map=svg(plots.field_map(history)),
        searched=svg(plots.searched_map(history, covered)),
        residuals=svg(plots.residuals(fit)) if fit.residual_db.size >= 10 else "",
        fits=_fit_by_robot(history, fit),
        probability=svg(plots.probability_over_time(history)),
        heard=svg(plots.detections_over_time(history)),
        use=svg(plots.use_of_robots(history, rows)),
    )


def searched(history: History) -> Coverage:
    """What was searched in a mission."""
    engine, field = history.mission.kernel.engine, history.mission.file.field
    return coverage(
        history.tracks,
        {robot: history.down(robot) for robot in history.tracks},
        engine.antenna,
        engine.power_levels_db,
        (field.size_east_m, field.size_north_m),
        engine.reference_rate_hz,
        history.duration_s,
    )


def refinements(history: History) -> list[Refined]:
    """The mission's sources refined: finds, and candidates with enough receptions. Inconsistent ones are not."""
    engine, field = history.mission.kernel.engine, history.mission.file.field
    wanted = [
        source
        for source in history.final
        if source.state == "found"
        or (source.state == "candidate" and source.p_exists > 0.5 and source.receptions >= FEW_RECEPTIONS)
    ]
    refined = refine(
        [detection for _, detection in history.detections],
        wanted,
        engine.antenna,
        size_m=(field.size_east_m, field.size_north_m),
        levels_db=engine.power_levels_db,
        place_sigma_m=engine.pose_sigma_m,
    )
    return placed(history, refined)


def _shown(history: History) -> list[SourceEstimate]:
    """Sources to be named: all but candidates that are probably none."""
    return [source for source in history.final if source.state != "candidate" or source.p_exists > 0.5]


def _cards(history: History, covered: Coverage) -> list[tuple[str, str]]:
    """The key figures, each with its unit or meaning."""
    cards = [
        (str(len(history.found)), "found" if len(history.found) != 1 else "source found"),
        (str(len(history.detections)), "transmissions heard"),
        (words.percent(covered.searched_share), "of the field searched"),
    ]
    if history.left:
        cards.append((words.percent(history.left[-1][1]), "one still hidden"))
    return [*cards, (words.minutes(history.duration_s), "of mission")]


def _place(history: History, source: SourceEstimate, refined: Refined | None) -> dict[str, Any]:
    """Where a source is as the one who goes there needs it: refined where that was possible, and how sure."""
    best: SourceEstimate | Refined = (
        refined if refined is not None and np.isfinite(refined.sigma_m) else source
    )
    lat_deg, lon_deg, _ = history.mission.frame.to_geodetic(best.east_m, best.north_m)
    said = coordinates(lat_deg, lon_deg)
    row = {"ident": source.ident, "state": source.state, "sure": "", "metres": "no position is claimed"}
    row |= {"lat_lon": "", "mgrs": ""}
    if source.state == "inconsistent":
        return row
    longest_m = ELLIPSE_90 * float(np.sqrt(np.linalg.eigvalsh(best.cov_m2)[-1]))
    sure = f"within {longest_m:.1f} m, 90 % sure" if np.isfinite(longest_m) else "no region can be given"
    metres = f"{best.east_m:.1f} m E, {best.north_m:.1f} m N"
    return row | {"sure": sure, "metres": metres, "lat_lon": said.lat_lon, "mgrs": said.mgrs}


def _row(history: History, source: SourceEstimate, refined: Refined | None) -> dict[str, Any]:
    from mission.analysis import plots

    lat, lon, _ = history.mission.frame.to_geodetic(source.east_m, source.north_m)
    row: dict[str, Any] = {
        "source": source,
        "sigma_m": float(np.sqrt(np.trace(source.cov_m2) / 2)),
        "lat_deg": lat,
        "lon_deg": lon,
        "words": coordinates(lat, lon),
        "error_m": _off(history, source.east_m, source.north_m),
        "refined": refined,
        "receptions": _receptions(history, refined),
        "map": svg(plots.source_map(history, source, refined)) if source.state != "inconsistent" else "",
    }
    if refined is not None:
        lat, lon, _ = history.mission.frame.to_geodetic(refined.east_m, refined.north_m)
        row |= {
            "refined_lat_deg": lat,
            "refined_lon_deg": lon,
            "refined_words": coordinates(lat, lon),
            "refined_error_m": _off(history, refined.east_m, refined.north_m),
        }
    return row


def _said(history: History) -> list[dict[str, Any]]:
    """What people said, with where they stood by their own track."""
    rows = []
    for t_s, word in history.said:
        track = history.tracks.get(word.robot or "")
        if track is None:
            continue
        east_m, north_m = (float(np.interp(t_s, track[:, 0], track[:, k])) for k in (1, 2))
        lat_deg, lon_deg, _ = history.mission.frame.to_geodetic(east_m, north_m)
        rows.append(
            {
                "t_s": t_s,
                "who": word.robot,
                "what": "a transmitter is here" if word.action == "mark" else word.reason,
                "east_m": east_m,
                "north_m": north_m,
                "lat_lon": coordinates(lat_deg, lon_deg).lat_lon,
            }
        )
    return rows


def _off(history: History, east_m: float, north_m: float) -> float | None:
    """Distance to the nearest true source; None where the truth is not known."""
    return min(
        (float(np.hypot(east_m - t["east_m"], north_m - t["north_m"])) for t in history.truth), default=None
    )


def _receptions(history: History, refined: Refined | None) -> list[dict[str, Any]]:
    """The transmissions that are this source's with more than even odds: when, who heard it how strongly."""
    if refined is None:
        return []
    rows = []
    for (t_s, detection), share in zip(history.detections, refined.share, strict=True):
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


def _fit_by_robot(history: History, fit: Fit) -> list[dict[str, Any]]:
    """The model fit of each robot's own readings: one radio that is off shows here."""
    rows = []
    for robot in history.tracks:
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
