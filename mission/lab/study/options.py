"""How a study is run, handed only to studies that take it: some run in one piece, some on other machines."""

import inspect
from collections.abc import Callable
from typing import Any

from fieldkit.errors import ConfigError

OPTIONAL = ("kept",)
"""Left out silently where a study does not take them: it then writes its results and cannot be resumed."""


def supported(study: Callable[..., Any], name: str, **given: Any) -> dict[str, Any]:
    """Those options that were given (not None) and that the study takes.

    Raises `ConfigError` for one that was asked for and that it does not take.
    """
    parameters = inspect.signature(study).parameters.values()
    takes_all = any(p.kind is inspect.Parameter.VAR_KEYWORD for p in parameters)
    taken = {p.name for p in parameters}
    wanted = {key: value for key, value in given.items() if value is not None}
    if takes_all:
        return wanted
    for key in wanted:
        if key not in taken and key not in OPTIONAL:
            raise ConfigError(f"study {name}: takes no --{key}; leave it out")
    return {key: value for key, value in wanted.items() if key in taken}
