"""A driver's options from a mission file, checked against a dataclass."""

import types
from collections.abc import Mapping
from dataclasses import MISSING, fields
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

from fieldkit.errors import ConfigError

Options = TypeVar("Options")
REMEDY = "remedy"
"""Key of a field's metadata: what to write where a needed option is missing."""
PORT = {REMEDY: 'write which one, as in port = "/dev/ttyUSB0"; "fieldkit devices" lists what is plugged in'}


def checked(kind: type[Options], given: Mapping[str, Any], where: str) -> Options:
    """`kind` built from `given`. Raises `ConfigError` naming key, what was expected and what was there."""
    known = {item.name: item for item in fields(kind)}  # type: ignore[arg-type]
    for key in given:
        if key not in known:
            raise ConfigError(f"{where}: unknown option '{key}'; known are: {', '.join(sorted(known))}")
    hints = get_type_hints(kind)
    for name, item in known.items():
        if name not in given:
            if item.default is MISSING and item.default_factory is MISSING:
                remedy = item.metadata.get(REMEDY, "write it")
                raise ConfigError(f"{where}: option '{name}' is missing: {remedy}")
            continue
        if not _fits(given[name], hints[name]):
            raise ConfigError(
                f"{where}: option '{name}': expected {_words(hints[name])}, got {given[name]!r}"
            )
    return kind(**{name: given[name] for name in given})


def _choices(hint: Any) -> tuple[Any, ...]:
    return get_args(hint) if get_origin(hint) in (Union, types.UnionType) else (hint,)


def _fits(value: Any, hint: Any) -> bool:
    for choice in _choices(hint):
        if choice is float and isinstance(value, int) and not isinstance(value, bool):
            return True
        choice = get_origin(choice) or choice  # of list[int] only the list is checked here
        if isinstance(value, choice) and not (isinstance(value, bool) and choice is not bool):
            return True
    return False


def _words(hint: Any) -> str:
    names = {int: "an integer", float: "a number", str: "a text", bool: "true or false", list[int]: "a list"}
    return " or ".join(
        names.get(choice, str(choice)) for choice in _choices(hint) if choice is not type(None)
    )
