"""Options of the commands that need parsing of their own."""

import tomllib
from typing import Any

from fieldkit.errors import ConfigError


def pairs(texts: list[str] | None) -> dict[str, str]:
    """NAME=VALUE, given any number of times."""
    found = {}
    for text in texts or []:
        name, sign, value = text.partition("=")
        if not sign:
            raise ConfigError(f"expected NAME=VALUE, got '{text}'")
        found[name.strip()] = value.strip()
    return found


def settings(texts: list[str] | None) -> dict[str, Any]:
    """NAME=VALUE for a driver: numbers, true and false as in mission.toml, anything else as text."""
    return {name: _value(text) for name, text in pairs(texts).items()}


def _value(text: str) -> Any:
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
    return value if isinstance(value, bool | int | float) else text


def headings(count: int) -> tuple[float, ...]:
    """`count` headings even round the circle, from 0 degrees; none for 0."""
    return tuple(360.0 * k / count for k in range(count))
