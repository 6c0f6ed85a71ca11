"""Scenarios by name, the same seeds for each: what the studies of shadowing and of disturbed worlds share."""

from collections.abc import Callable, Sequence
from typing import Any, Protocol, TypeVar

from mission.core.kernel import Kernel
from mission.lab.study.pool import Progress, Trial, having, run_trials

FOUND_WITHIN_M = 1.0
"""A source is found when a find lies within this of it."""
LOOK_EVERY_NS = 10_000_000_000


class Named(Protocol):
    """A row of a study."""

    @property
    def name(self) -> str: ...


S = TypeVar("S", bound=Named)


class Sometimes:
    """Looks every few simulated seconds; the commands pass through unchanged."""

    def __init__(self, watch: Callable[[Kernel, Any, Any], Any]) -> None:
        self._watch, self._next_ns = watch, 0

    def __call__(self, kernel: Kernel, event: Any, outcome: Any) -> Any:
        if event.t_ns >= self._next_ns:
            self._next_ns = event.t_ns + LOOK_EVERY_NS
            return self._watch(kernel, event, outcome)
        return outcome.commands


def run_scenarios(
    study: str,
    scenarios: Sequence[S],
    job: Callable[[S, int], Any],
    trial: Trial,
    summarise: Callable[[list[dict[str, Any]]], dict[str, Any]],
    trials: int,
    seed: int,
    progress: Progress,
    *,
    only: str = "",
    **how: Any,
) -> dict[str, Any]:
    """The scenario named `only`, or those whose name contains it, `trials` each from `seed` on.

    `how` goes to `run_trials`.
    """
    names = having(only, (each.name for each in scenarios))
    wanted = [(each, seed + k) for each in scenarios if each.name in names for k in range(trials)]
    rows = run_trials(trial, [job(*each) for each in wanted], progress, **how)
    grouped: dict[str, list[dict[str, Any]]] = {}
    for (scenario, _), row in zip(wanted, rows, strict=True):
        grouped.setdefault(scenario.name, []).append(row)
    return {
        "study": study,
        "trials": trials,
        "seed": seed,
        "scenarios": {name: summarise(group) for name, group in grouped.items()},
    }
