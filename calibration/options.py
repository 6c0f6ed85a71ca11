"""Options of the commands that need parsing of their own."""

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


def headings(count: int) -> tuple[float, ...]:
    """`count` headings even round the circle, from 0 degrees; none for 0."""
    return tuple(360.0 * k / count for k in range(count))
