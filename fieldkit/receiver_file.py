"""A file that describes one receiver by the keys of a mission file's `receiver`, for who has no mission file."""

import tomllib
from pathlib import Path
from typing import Any

from fieldkit.errors import ConfigError


def read_receiver(path: Path, option: str = "--receiver") -> dict[str, Any]:
    """Its table; the driver is `lines` where it says none. Raises `ConfigError`, naming the `option` that asked."""
    try:
        said = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigError(f"{option} {path}: cannot be read: {error}") from error
    if "port" not in said:
        raise ConfigError(f"{option} {path}: expected at least 'port' and a map, see docs/lines.md")
    table = {"driver": "lines", **said}
    if not isinstance(table["driver"], str):
        raise ConfigError(f"{option} {path}: driver: expected a text, got {table['driver']!r}")
    return table
