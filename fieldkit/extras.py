"""Packages that are not always installed: a clear word instead of an ImportError."""

import importlib
from typing import Any

from fieldkit.errors import ConfigError


def need(module: str, extra: str) -> Any:
    """The module `module`. Raises `ConfigError` that names the extra to install where it is not there."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise ConfigError(
            f"this needs {module.partition('.')[0]}, which is not installed: pip install 'spog-fieldkit[{extra}]'"
        ) from error
