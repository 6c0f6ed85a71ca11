"""What to do after a mission, for the person who decides. Pure: sentences from what the report knows."""

from collections.abc import Sequence

from fieldkit.messages import SourceEstimate
from mission.analysis.coverage import Coverage
from mission.analysis.history import History
from mission.analysis.refine import Fit
from mission.analysis.words import does_not_fit, percent

FAINT_LEFT = 0.05
"""A probability below this that one is left is no reason to search on."""
MANY_HOLDS = 20


def next_steps(history: History, covered: Coverage, fit: Fit) -> list[str]:
    """What to do, the most urgent first; never empty."""
    steps: list[str] = []
    if history.recording.missing:
        steps.append(
            "Mend the recording before it is copied: fieldkit log recover writes all that is intact."
        )
    for source in history.final:
        steps += _of_source(source)
    if not history.detections:
        steps.append(
            "Check a radio with a transmitter of the searched kind beside it: a radio on another channel hears nothing "
            "and looks fine otherwise."
        )
    elif does_not_fit(fit):
        steps.append(
            "Calibrate these radios again before the next mission: their readings do not fit the antenna file."
        )
    if history.left and history.left[-1][1] > FAINT_LEFT:
        where = f", most of all in {covered.weakest()[0]}" if covered.searched_share < 1.0 else ""
        steps.append(
            f"Search on{where}: that one is still hidden has a probability of {percent(history.left[-1][1])}."
        )
    if len(history.holds) > MANY_HOLDS:
        steps.append(
            f"Look at why safety held robots {len(history.holds)} times (Faults): they may be too many for the field, "
            "or min_separation_m, turn_radius_m or the noise of positions are too large for it."
        )
    return steps or ["Nothing: all that was heard is explained, and the field was searched."]


def _of_source(source: SourceEstimate) -> Sequence[str]:
    match source.state:
        case "inconsistent":
            return [f"Do not trust source {source.ident}: {source.note}. Listen again from other sides."]
        case "outside":
            return [f"Source {source.ident} lies beyond the field: enlarge the field if it matters."]
        case "candidate" if source.p_exists > 0.5:
            return [
                f"Go on with candidate {source.ident}: a few more receptions from near it settle where it is."
            ]
        case "found" if source.note:
            return [f"Look twice at source {source.ident}: {source.note}."]
    return []
