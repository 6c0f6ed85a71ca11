"""What went wrong in a mission, in order of time: receivers, links, holds, warnings, and what the recording lacks."""

from mission.analysis.history import History

Fault = tuple[float, str, str]
"""Time s, who, what."""


def faults(history: History) -> list[Fault]:
    """Every fault, each said once: repeated orders of safety for one reason count as one."""
    rows: list[Fault] = []
    for robot, changes in history.receivers.items():
        for t_s, up, reason in changes:
            if not up:
                back = next((t for t, again, _ in changes if again and t > t_s), None)
                rest = "to the end" if back is None else f"for {back - t_s:.0f} s"
                rows.append((t_s, robot, f"receiver down {rest}{': ' + reason if reason else ''}"))
    for robot, modes in history.modes.items():
        for index, (t_s, mode) in enumerate(modes):
            if mode in ("link down", "other", "unknown"):
                back = modes[index + 1][0] if index + 1 < len(modes) else None
                rest = "to the end" if back is None else f"for {back - t_s:.0f} s"
                said = {"link down": "link down", "other": "in a mode that is not ours"}.get(
                    mode, "in an unknown mode"
                )
                rows.append((t_s, robot, f"{said} {rest}"))
    last: dict[str, str] = {}
    for t_s, hold in history.holds:
        if last.get(hold.robot) != hold.reason and not _is_the_end(history, t_s):
            rows.append((t_s, hold.robot, f"held by safety: {hold.reason}"))
        last[hold.robot] = hold.reason
    rows += [(t_s, "", text) for t_s, level, text in history.notes if level in ("warning", "error")]
    return sorted(rows, key=lambda row: row[0])


def _is_the_end(history: History, t_s: float) -> bool:
    """Every mission ends with its robots held."""
    return history.result is not None and t_s >= history.duration_s - 1.0
