"""Things chosen by name: drivers, beliefs, planners, commands. A user's own package adds to the same groups."""

from collections.abc import Iterator
from functools import cache
from importlib.metadata import EntryPoints, entry_points
from typing import Any

from fieldkit.errors import ConfigError


@cache
def _known(group: str) -> EntryPoints:
    """Read once: it opens a file of every package there is, and what is installed does not change while we run."""
    return entry_points(group=group)


def names(group: str) -> list[str]:
    """The names known in an entry-point group such as `fieldkit.receivers`, sorted."""
    return sorted({point.name for point in _known(group)})


def load(group: str, name: str) -> Any:
    """The object behind a name. Raises `ConfigError` that lists the names there are."""
    for point in _known(group):
        if point.name == name:
            try:
                return point.load()
            except ImportError as error:
                raise ConfigError(
                    f"{group}: '{name}' is known ({point.value}) but cannot be imported: {error}. "
                    "Install what it needs, often an extra such as spog-fieldkit[camera]."
                ) from error
    known = ", ".join(names(group)) or "none: is fieldkit installed (pip install -e .)?"
    raise ConfigError(f"{group}: no '{name}'; known names are: {known}")


def load_all(group: str) -> Iterator[tuple[str, Any]]:
    """Every (name, object) of a group, by name."""
    for name in names(group):
        yield name, load(group, name)
