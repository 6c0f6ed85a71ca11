"""Defaults of mission.toml as they were when a mission was recorded.

A recording holds the mission file as it was written. What the file leaves open goes into the recording as well, so that
a later fieldkit, whose defaults may be others, replays the mission that was flown.
"""

import json
import math
from collections.abc import Mapping
from typing import Any

import tomlkit

from mission.core.tables import (
    AssociationTable,
    EndTable,
    EngineTable,
    MissionFile,
    SafetyTable,
    SourcesTable,
)

TABLES = {
    "sources": SourcesTable(),
    "engine": EngineTable(),
    "association": AssociationTable(),
    "end": EndTable(),
    "safety": SafetyTable(),
}
"""The tables that decide what a mission does, as an empty file has them."""


def left_open(file: MissionFile) -> dict[str, dict[str, Any]]:
    """What a mission file does not say, and what it was by default: table, key, value."""
    return {
        name: {
            key: value
            for key, value in _plain(getattr(file, name)).items()
            if key not in getattr(file, name).model_fields_set
        }
        for name in TABLES
    }


def filled_in(text: str, recorded: Mapping[str, Mapping[str, Any]]) -> str:
    """A mission file with what it left open as recorded, where today's default is another.

    Raises `ValueError` for a key that today's mission files do not have.
    """
    missing = {}
    for name, keys in recorded.items():
        today = _plain(TABLES[name]) if name in TABLES else {}
        for key, value in keys.items():
            if name not in TABLES or key not in type(TABLES[name]).model_fields:
                raise ValueError(f"{name}.{key}: no such key today")
            if today.get(key) != value:
                missing[name, key] = value
    if not missing:
        return text
    document = tomlkit.parse(text)
    for (name, key), value in missing.items():
        table: Any = document.setdefault(name, tomlkit.table())
        table.setdefault(key, value)
    return tomlkit.dumps(document)


def _plain(table: Any) -> dict[str, Any]:
    """Values that TOML and JSON have alike; what is unlimited or not given has none."""
    values = json.loads(table.model_dump_json())
    return {
        key: value
        for key, value in values.items()
        if value is not None and not (isinstance(value, float) and math.isinf(value))
    }
