"""A mission in sentences, for people who were not there: what was found, how sure, and what may be left."""

import numpy as np

from mission.analysis.coverage import SEARCHED, Coverage
from mission.analysis.history import History
from mission.analysis.refine import Fit

FEW_READINGS = 10
"""Fewer say nothing of whether the antenna file fits."""
ODD_BIAS_DB, ODD_RATIO = 2.0, 1.3
"""Readings that are off by more on average, or scatter so many times as wide, do not look like the antenna file."""


def found(history: History) -> list[str]:
    """What was heard and found, and how sure that is."""
    sentences = []
    if history.recording.missing:
        sentences.append(f"The recording is not whole: {history.recording.missing}.")
    heard = len(history.detections)
    if not heard:
        return [*sentences, f"In {minutes(history.duration_s)} nothing was heard, so nothing was found."]
    count = len(history.found)
    sentences.append(
        f"In {minutes(history.duration_s)} the team heard {heard} transmission{'s' * (heard > 1)} and found "
        f"{count or 'no'} source{'s' * (count != 1)}."
    )
    within = found_within(history)
    for source in history.found:
        sigma = float(np.sqrt(np.trace(source.cov_m2) / 2))
        sentences.append(
            f"Source {source.ident} is at {source.east_m:.2f} m east, {source.north_m:.2f} m north (standard deviation "
            f"{sigma:.2f} m): {percent(source.p_here)} sure within {within}, from {source.receptions:.0f} receptions."
        )
    for source in history.final:
        if source.state == "inconsistent":
            sentences.append(f"No position is claimed for source {source.ident}: {source.note}.")
        elif source.state == "outside":
            sentences.append(f"Source {source.ident} is {source.note}: it does not count as found.")
        elif source.state == "candidate" and source.p_exists > 0.5:
            sentences.append(
                f"Candidate {source.ident} near {source.east_m:.1f} m east, {source.north_m:.1f} m north is not "
                f"resolved ({source.receptions:.1f} receptions; {percent(source.p_here)} sure within {within})."
            )
    return sentences


def found_within(history: History) -> str:
    """How near to its estimate a find has to be."""
    radius_m = history.mission.kernel.engine.find_radius_m
    return "one cell" if radius_m is None else f"{radius_m:.2g} m"


def silent(history: History, covered: Coverage) -> list[str]:
    """What was searched and stayed silent, and what may be left."""
    field = history.mission.file.field
    every_s = 1.0 / covered.rate_hz
    share, whole_m2 = percent(covered.searched_share), field.size_east_m * field.size_north_m
    sentences = [
        f"{share} of the field ({covered.searched_m2:.0f} of {whole_m2:.0f} m²) was searched: a source there that "
        f"sends every {every_s:.0f} s on average would have been heard with {100.0 * SEARCHED:.0f} % or more."
    ]
    if covered.searched_share < 1.0:
        where, mean = covered.weakest()
        sentences.append(
            f"Least was searched in {where}: there it would have been heard with {percent(mean)} on average."
        )
    if history.left:
        left = history.left[-1][1]
        sentences.append(
            f"The probability that a source sending so often or oftener is still unfound is {percent(left)}"
            + (": another search is advisable." if left > 0.2 else ".")
        )
    return sentences


def fit(readings: Fit) -> str:
    """Whether readings look like what the antenna file predicts."""
    n = readings.residual_db.size
    if n < FEW_READINGS:
        return f"Only {n} readings can be compared with the antenna file's prediction: too few to say whether it fits."
    return (
        f"{n} readings scatter {readings.spread_db:.1f} dB around the antenna file's prediction, which promises "
        f"{readings.promised_db:.1f} dB, and are {readings.bias_db:+.1f} dB off on average: "
        + (
            "the antenna file fits."
            if not does_not_fit(readings)
            else "the antenna file does not fit; calibrate these radios again."
        )
    )


def does_not_fit(readings: Fit) -> bool:
    """Whether the readings are off by more, or scatter wider, than the antenna file allows."""
    if readings.residual_db.size < FEW_READINGS:
        return False
    ratio = readings.spread_db / readings.promised_db
    return abs(readings.bias_db) > ODD_BIAS_DB or ratio > ODD_RATIO


def ending(history: History) -> list[str]:
    """Why it ended, and whether safety had to step in."""
    sentences = []
    if history.result is not None:
        sentences.append(f"The mission ended because {history.result['end_reason']}.")
    else:
        sentences.append("The recording ends before the mission did.")
    held = sorted({hold.robot for _, hold in history.holds})
    if held:
        sentences.append(f"Safety held {', '.join(held)} ({len(history.holds)} orders).")
    return sentences


def minutes(duration_s: float) -> str:
    """A duration as people say it."""
    if duration_s < 180.0:
        return f"{duration_s:.0f} s"
    return f"{duration_s / 60.0:.0f} min" if duration_s < 7200.0 else f"{duration_s / 3600.0:.1f} h"


def percent(share: float) -> str:
    """A probability without claiming certainty that rounding made."""
    if 0.995 <= share < 1.0:
        return "over 99 %"
    if 0.0 < share < 0.005:
        return "under 1 %"
    return f"{100.0 * share:.0f} %"
