"""Find unknown, short-lived radio transmitters with a team of small robots.

The public API for notebooks and for packages that add drivers, beliefs, planners and commands:

    import fieldkit

    antenna = fieldkit.calibrate("readings.csv").antenna_file
    mission = fieldkit.read_mission("mission.toml")
    result = fieldkit.simulate(mission, sources=[(3.0, 4.0), (7.5, 6.0)], recording="run.mcap")
    fieldkit.plot_field("run.mcap").savefig("field.png")

Names are imported on first use: `import fieldkit` itself reads nothing but this file.

Stability: what `fieldkit.__all__` lists is public, and so are the members without a leading underscore of the
modules listed there (`messages`, `ports`, `errors`, `testing`). A change that breaks it is announced in CHANGELOG.md
with a deprecation warning one minor version before. Also stable: the entry-point groups `fieldkit.*`, mission.toml,
the antenna file and the recording, which carry a schema number each. Everything else may change at any time.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

_HOME_OF = {
    "AntennaFile": "fieldkit.channel.antenna_file",
    "Antenna": "fieldkit.channel.model",
    "Belief": "fieldkit.engine.belief.base",
    "EngineSettings": "fieldkit.engine.settings",
    "FieldFrame": "fieldkit.geo",
    "Grid": "fieldkit.engine.grid",
    "InformativeBelief": "fieldkit.engine.planning.base",
    "Log": "fieldkit.recording.log",
    "Planner": "fieldkit.engine.planning.base",
    "Situation": "fieldkit.engine.planning.base",
    "TransientSource": "fieldkit.world.sources",
    "Unresolved": "fieldkit.engine.belief.base",
    "belief_names": "fieldkit.engine.by_name",
    "make_belief": "fieldkit.engine.by_name",
    "make_planner": "fieldkit.engine.by_name",
    "open_log": "fieldkit.recording.log",
    "planner_names": "fieldkit.engine.by_name",
    "read_antenna": "fieldkit.channel.antenna_file",
}
"""Public name to the module of fieldkit that holds it."""
_MODULES = frozenset({"errors", "messages", "ports", "testing"})
_BY_ENTRY_POINT = frozenset(
    {
        "Calibration",
        "Mission",
        "SimulatedMission",
        "calibrate",
        "plot_calibration",
        "plot_field",
        "plot_history",
        "read_mission",
        "simulate",
    }
)
"""Names that calibration and mission give through the entry-point group `fieldkit.api`: fieldkit imports neither."""

if TYPE_CHECKING:
    from calibration.notebook import Calibration, calibrate, plot_calibration
    from fieldkit import errors, messages, ports, testing
    from fieldkit.channel.antenna_file import AntennaFile, read_antenna
    from fieldkit.channel.model import Antenna
    from fieldkit.engine.belief.base import Belief, Unresolved
    from fieldkit.engine.by_name import belief_names, make_belief, make_planner, planner_names
    from fieldkit.engine.grid import Grid
    from fieldkit.engine.planning.base import InformativeBelief, Planner, Situation
    from fieldkit.engine.settings import EngineSettings
    from fieldkit.geo import FieldFrame
    from fieldkit.recording.log import Log, open_log
    from fieldkit.world.sources import TransientSource
    from mission.analysis.notebook import plot_field, plot_history
    from mission.core.mission_file import Mission, read_mission
    from mission.lab.simulated import SimulatedMission, simulate

__all__ = [
    "Antenna",
    "AntennaFile",
    "Belief",
    "Calibration",
    "EngineSettings",
    "FieldFrame",
    "Grid",
    "InformativeBelief",
    "Log",
    "Mission",
    "Planner",
    "SimulatedMission",
    "Situation",
    "TransientSource",
    "Unresolved",
    "__version__",
    "belief_names",
    "calibrate",
    "errors",
    "make_belief",
    "make_planner",
    "messages",
    "open_log",
    "planner_names",
    "plot_calibration",
    "plot_field",
    "plot_history",
    "ports",
    "read_antenna",
    "read_mission",
    "simulate",
    "testing",
]


def __getattr__(name: str) -> Any:
    """Import a public name on first use (PEP 562). Raises `ConfigError` where the installation lacks it."""
    if name in _HOME_OF:
        value = getattr(import_module(_HOME_OF[name]), name)
    elif name in _MODULES:
        value = import_module(f"{__name__}.{name}")
    elif name in _BY_ENTRY_POINT:
        from fieldkit import plugins

        value = plugins.load("fieldkit.api", name)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
