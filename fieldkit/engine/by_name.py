"""Beliefs and planners by the names under which packages offer them (entry points)."""

from typing import cast

from fieldkit import plugins
from fieldkit.engine.belief.base import Belief
from fieldkit.engine.planning.base import Planner
from fieldkit.engine.settings import EngineSettings

BELIEFS, PLANNERS = "fieldkit.beliefs", "fieldkit.planners"


def belief_names() -> list[str]:
    """The beliefs there are, sorted: values of `engine.belief` in mission.toml."""
    return plugins.names(BELIEFS)


def planner_names() -> list[str]:
    """The planners there are, sorted: values of `engine.planner` in mission.toml."""
    return plugins.names(PLANNERS)


def make_belief(name: str, settings: EngineSettings) -> Belief:
    """A new belief over `settings.grid`.

    Raises `ConfigError` for a name there is not (it lists those there are), or for settings the belief cannot use.
    """
    return cast(Belief, plugins.load(BELIEFS, name)(settings))


def make_planner(name: str, settings: EngineSettings) -> Planner:
    """A new planner. Raises `ConfigError` for a name there is not (it lists those there are)."""
    return cast(Planner, plugins.load(PLANNERS, name)(settings))
