"""One receiver in the words of an option, or in a file of its own, for who has no mission file."""

import tomllib
from pathlib import Path
from typing import Any

from fieldkit.errors import ConfigError, os_words
from fieldkit.files import is_stream


def receiver_of(words: str) -> dict[str, Any]:
    """A receiver's table from `xbee:PORT`, `PORT[,MAP]` of a radio that prints, or a file. Raises `ConfigError`."""
    if words == "xbee:" or words.startswith(","):
        raise ConfigError(
            f"--receiver {words}: expected a port, as in xbee:/dev/ttyUSB0 or /dev/ttyUSB0,rylr"
        )
    if words.startswith("xbee:"):
        return {"driver": "xbee", "port": words.removeprefix("xbee:")}
    if words.endswith(".toml"):
        return read_receiver(Path(words))
    port, _, line_map = words.partition(",")
    return {"driver": "lines", "port": port, "map": line_map or "json"}


def read_receiver(path: Path) -> dict[str, Any]:
    """Its table; the driver is `lines` where it says none. Raises `ConfigError`."""
    if is_stream(path):
        raise ConfigError(f"--receiver {path}: expected a file, got a pipe or device")
    try:
        said = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigError(f"--receiver {path}: cannot be read: {os_words(error)}") from error
    if "port" not in said:
        raise ConfigError(f"--receiver {path}: expected at least 'port' and a map, see docs/lines.md")
    table = {"driver": "lines", **said}
    if not isinstance(table["driver"], str):
        raise ConfigError(f"--receiver {path}: driver: expected a text, got {table['driver']!r}")
    return table
