"""Accepted, accepted with warnings, or refused: always with the reason and what to do about it."""

from dataclasses import dataclass

import numpy as np

from calibration import channel, diagnose
from calibration.fit import FitResult
from fieldkit.channel.antenna_file import Verdict as State

MIN_PLACES, FEW_PLACES = 5, 10
MIN_SPAN_DECADES = 0.5
USUAL_EXPONENT = (1.5, 4.0)
"""Near the ground; 802.15.4 radios between 1.5 and 3.5."""
WIDE_EXPONENT = 0.75
"""Half-width of the exponent's 95 % interval above which ranges are a guess."""
LARGE_SIGMA_DB = 8.0
CUT_RULES = ((3.0, 0.3), (10.0, 0.1))
"""Log-likelihood ratio of truncation and share of places cut short that together are enough."""
THINNED_SHARE = 0.1
SURE = 0.01
SWING_WARN_DB, SWING_REFUSE_DB = 3.0, 6.0
SWING_REFUSE_SIGMA = 1.25
"""A bend refuses where it is also larger than this many sigma: below that the scatter hides it anyway."""
SEVERAL_TRANSMITTERS, SWING_REFUSE_SPREAD = 3, 3.0
"""With so many transmitters a bend may be so many deviations of their shadowing and lobes before it refuses."""
HEADING_WARN_DB, HEADING_REFUSE_DB = 2.0, 6.0
RECEIVERS_WARN_DB = 2.0


@dataclass(frozen=True, slots=True)
class Judgement:
    """The verdict. `refusals` and `warnings` each say what is wrong and what to do."""

    refusals: tuple[str, ...]
    warnings: tuple[str, ...]

    @property
    def state(self) -> State:
        if self.refusals:
            return "refused"
        return "accepted with warnings" if self.warnings else "accepted"

    @property
    def reasons(self) -> tuple[str, ...]:
        return (*self.refusals, *self.warnings)


def judge(result: FitResult) -> Judgement:
    """What a fit is good for."""
    refusals: list[str] = []
    warnings = list(result.readings.warnings)
    _coordinates(result, refusals, warnings)
    _units(result, refusals)
    _amount(result, refusals, warnings)
    _exponent(result, refusals, warnings)
    _missed(result, refusals, warnings)
    _structure(result, refusals, warnings)
    _spread(result, warnings)
    return Judgement(tuple(refusals), tuple(warnings))


def _coordinates(result: FitResult, refusals: list[str], warnings: list[str]) -> None:
    what, sure = diagnose.swapped(result)
    if sure:
        refusals.append(f"it looks as if {what}: the readings fit much better that way; correct the file")
    elif what:
        warnings.append(f"the readings fit somewhat better as if {what}; check the file")


def _units(result: FitResult, refusals: list[str]) -> None:
    what = diagnose.mixed_units(result)
    if what:
        refusals.append(f"it looks as if {what}: give all distances in metres")


def _amount(result: FitResult, refusals: list[str], warnings: list[str]) -> None:
    if not result.converged:
        refusals.append("the fit did not converge; look at the plot for mixed units or two kinds of radio")
    if result.n_places < MIN_PLACES:
        refusals.append(
            f"readings from {result.n_places} places: errors cannot be known from fewer than "
            f"{MIN_PLACES}; collect "
            "at 20 or more, few readings each: many at one spot do not help"
        )
    elif result.n_places < FEW_PLACES:
        warnings.append(f"only {result.n_places} places: intervals are wide and rough; collect at 20 or more")
    span = diagnose.span_decades(result)
    if span < MIN_SPAN_DECADES:
        refusals.append(
            f"distances span a factor of {10**span:.2g} only, so the exponent is not identified; "
            "collect from the nearest to the farthest, at least a factor of 3.2, better 20"
        )


def _exponent(result: FitResult, refusals: list[str], warnings: list[str]) -> None:
    beta = result.antenna.path_loss_exponent
    low, high = result.intervals_95["path_loss_exponent"]
    shown = f"{beta:.2f} ({low:.2f} to {high:.2f})"
    if beta <= 0.0:
        refusals.append(
            f"the exponent is {shown}: level rises with distance; check the distances and the sign"
        )
    elif not low > 0.0:
        refusals.append(f"the exponent {shown} may be zero; collect at more places, nearer and farther")
    elif not USUAL_EXPONENT[0] <= beta <= USUAL_EXPONENT[1]:
        warnings.append(
            f"the exponent {shown} is outside the usual {USUAL_EXPONENT[0]} to {USUAL_EXPONENT[1]}"
        )
    if (high - low) / 2.0 > WIDE_EXPONENT and low > 0.0:
        warnings.append(f"the exponent {shown} is not well known; collect at more places, far and near")
    without = diagnose.near_field(result)
    if without is not None and abs(without[0] - beta) > max(0.3, 2.0 * without[1]):
        warnings.append(
            f"without the places under 0.5 m the exponent is {without[0]:.2f}, not {beta:.2f}: "
            "the near field or "
            "saturation bends the curve; consider --min-distance-m 0.5"
        )


def _missed(result: FitResult, refusals: list[str], warnings: list[str]) -> None:
    if result.missed == "uncounted":
        refusals.append(
            "weak packets are absent and nobody knows how many: the fit cannot be trusted; log "
            "every packet sent "
            "(sequence numbers or a known period), leaving rss_dbm empty where it was not received"
        )
    elif _looks_cut(result):
        weakest = float(result.threshold.dbm) + 1.0
        refusals.append(
            f"readings stop short at {weakest:g} dBm and no missed packet is in the file: weak "
            "ones look cut off, "
            "which makes the exponent too small; log missed packets as empty readings, or say "
            "--missed none if "
            "every packet was received"
        )
    elif not result.threshold.identified:
        warnings.append(
            "no packet was missed: the threshold lies somewhere below "
            f"{result.threshold.dbm + 1:g} dBm; collect "
            "farther away, counting the packets that do not arrive"
        )
    if result.threshold.jitter_db > 1.0:
        warnings.append(
            f"the threshold jitters by {result.threshold.jitter_db:.1f} dB; "
            f"{result.threshold.dbm:.1f} dBm is its middle"
        )
    if result.n_lost_near:
        warnings.append(
            f"{result.n_lost_near} packets were missed where all should be heard (collisions, or "
            "the receiver was "
            "busy); they were left out"
        )


def _looks_cut(result: FitResult) -> bool:
    ratio, share = diagnose.truncation(result), diagnose.cut_short(result)
    by_shape = any(ratio > least and share >= places for least, places in CUT_RULES)
    return not result.stated and (by_shape or diagnose.thinned(result) > THINNED_SHARE)


def _structure(result: FitResult, refusals: list[str], warnings: list[str]) -> None:
    heading = diagnose.against_heading(result)
    if heading is not None and heading.p_value < SURE and heading.swing_db > HEADING_WARN_DB:
        text = (
            f"levels swing by {heading.swing_db:.1f} dB with heading: an antenna pattern is "
            "missing; fit one (--pattern auto)"
        )
        (refusals if heading.swing_db > HEADING_REFUSE_DB else warnings).append(text)
    apart = diagnose.between_receivers(result)
    if apart is not None and apart.p_value < SURE and apart.swing_db > RECEIVERS_WARN_DB:
        warnings.append(
            f"receivers differ by {apart.swing_db:.1f} dB, which sigma takes for noise; fit each one's offset "
            "(--receiver-offsets)"
        )
    bend = diagnose.against_distance(result)
    if bend is not None and bend.p_value < SURE and bend.swing_db > SWING_WARN_DB:
        text = (
            f"levels bend away from the straight line by {bend.swing_db:.1f} dB over these "
            "distances (near field, "
            "ground reflection or a wall); fit only the distances you will use (--min-distance-m)"
        )
        limit = max(SWING_REFUSE_DB, SWING_REFUSE_SIGMA * result.antenna.sigma_db)
        spread, found, _ = channel.measured(result)
        if found is not None and spread.transmitters >= SEVERAL_TRANSMITTERS:
            # Lobes and shadowing of several transmitters bend the mean, and the belief knows of both.
            limit = max(limit, SWING_REFUSE_SPREAD * float(np.hypot(spread.sigma_place_db, spread.lobe_db)))
        (refusals if bend.swing_db > limit else warnings).append(text)


def _spread(result: FitResult, warnings: list[str]) -> None:
    sigma = result.antenna.sigma_db
    if sigma > LARGE_SIGMA_DB:
        warnings.append(
            f"sigma is {sigma:.1f} dB; above {LARGE_SIGMA_DB:g} headings or obstacles usually matter"
        )
    if result.n_outliers:
        warnings.append(f"{result.n_outliers} readings more than 5 sigma from the fit were left out")
    share = result.n_saturated / max(1, result.n_readings)
    if share > 0.5:
        warnings.append(f"{share:.0%} of the readings are saturated; collect farther away")
