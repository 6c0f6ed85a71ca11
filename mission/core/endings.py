"""What ends a mission by itself: its time, nobody left to steer, everything found, or nothing more found for long."""

from dataclasses import dataclass

from mission.core.kernel_settings import KernelSettings


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a mission has come."""

    elapsed_s: float
    idle_s: float
    """For so long no robot could be steered."""
    found_at_s: tuple[float, ...]
    """When each source that counts as found was found."""


def reason_to_end(settings: KernelSettings, progress: Progress) -> str:
    """Why the mission is over, or nothing."""
    if progress.elapsed_s >= settings.max_duration_s:
        return f"time is up ({settings.max_duration_s:.0f} s)"
    if progress.idle_s > settings.idle_limit_s:
        return f"no robot could be steered for {settings.idle_limit_s:.0f} s"
    wanted = settings.sources_expected
    if wanted is not None and len(progress.found_at_s) >= wanted:
        return f"all {wanted} expected sources are found" if wanted != 1 else "the expected source is found"
    periods = settings.stop_after_periods
    if periods is not None:
        latest_s = max(progress.found_at_s, default=0.0)
        if progress.elapsed_s - latest_s >= periods * settings.engine.planning_period_s:
            return f"nothing more was found in {periods} planning periods"
    return ""
