"""The draft on the desk of the editor: held in memory, judged as it changes, written when it is asked for."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fieldkit import plugins
from fieldkit.errors import ConfigError, os_words
from fieldkit.files import is_stream, write_whole
from fieldkit.geo import FieldFrame
from mission.core.template import mission_text
from mission.maps.background import PICTURES, TILES, Background, Ground, background_of
from mission.plan.draft import form_of, plain_field, with_form
from mission.plan.judge import judge
from mission.plan.protocol import Choices, Draft, HeardVehicle, Standing

MOST_FILES = 200
MOST_LAT_DEG = 85.0
"""Web maps end there."""
LARGEST_M = 1e6


class Desk:
    """One mission file being edited. Raises `ConfigError` where there is one that is no TOML."""

    def __init__(self, path: Path) -> None:
        self.path = path.absolute()
        self._stored = self._on_disk()
        self.text = mission_text(name=self.path.stem, robots=()) if self._stored is None else self._stored
        form_of(self.text)
        self._heard: dict[int, tuple[float, float]] = {}

    def state(self) -> Draft:
        """All that the page shows of it."""
        return {
            "path": str(self.path),
            "form": form_of(self.text),
            "text": self.text,
            "remarks": [
                {"level": each.level, "key": each.key, "text": each.text}
                for each in judge(self.text, self.path)
            ],
            "stored": self.text == self._stored,
            "new": self._stored is None,
            "standing": self._standing(),
        }

    def choices(self) -> Choices:
        """What there is to choose from: drivers, and files beside the mission file."""
        return {
            "receivers": plugins.names("fieldkit.receivers"),
            "vehicles": plugins.names("fieldkit.vehicles"),
            "antennas": [each.name for each in self._beside() if _is_antenna(each)],
            "pictures": [each.name for each in self._beside() if each.suffix.lower() in (TILES, *PICTURES)],
        }

    def change(self, form: Mapping[str, Any]) -> None:
        """Take in what the form says now. Raises `ConfigError`."""
        self.text = with_form(self.text, form)

    def hear(self, vehicles: Sequence[HeardVehicle]) -> None:
        """Keep where these vehicles are, for the map."""
        for each in vehicles:
            if each["place_deg"]:
                self._heard[each["system_id"]] = each["place_deg"]

    def background(self) -> Background | None:
        """What the picture named in the draft has of its field; None where none is named. Raises `ConfigError`."""
        field = plain_field(self.text)
        name = field.get("background")
        if not name:
            return None
        frame, east_m, north_m = self._frame(), _number(field, "size_east_m"), _number(field, "size_north_m")
        if not (frame and 0 < east_m < LARGEST_M and 0 < north_m < LARGEST_M):
            raise ConfigError(
                "field.background: where the field is must be known first: its corner and its size"
            )
        return background_of(
            Ground(frame, east_m, north_m),
            self.path.parent / str(name),
            str(field.get("background_crs") or ""),
        )

    def store(self) -> None:
        """Write the file, whole or not at all.

        Raises `ConfigError` where somebody else has changed it meanwhile, `NotWritten` where it cannot be written.
        """
        if self._on_disk() != self._stored:
            raise ConfigError(
                f"{self.path}: was changed by somebody else since it was read; nothing was written. "
                "Open it anew to see that, and repeat your changes"
            )
        write_whole(self.path, self.text)
        self._stored = self.text

    def _frame(self) -> FieldFrame | None:
        """The draft's local frame; None where its corner is not known."""
        field = plain_field(self.text)
        lat_deg, lon_deg = _number(field, "origin_lat_deg"), _number(field, "origin_lon_deg")
        known = abs(lat_deg) <= MOST_LAT_DEG and abs(lon_deg) <= 180.0
        return FieldFrame(lat_deg, lon_deg) if known else None

    def _standing(self) -> list[Standing]:
        frame = self._frame()
        return [
            {"name": f"system {system_id}", "place": frame.to_local(*place_deg)[:2]}
            for system_id, place_deg in self._heard.items()
            if frame is not None
        ]

    def _on_disk(self) -> str | None:
        if is_stream(self.path):
            raise ConfigError(f"{self.path}: expected a mission file, got a pipe or device")
        try:
            return self.path.read_text(encoding="utf-8").removeprefix("\ufeff")
        except FileNotFoundError:
            return None
        except (OSError, UnicodeDecodeError) as error:
            raise ConfigError(f"{self.path}: cannot be read: {os_words(error)}") from error

    def _beside(self) -> list[Path]:
        try:
            return sorted(each for each in self.path.parent.iterdir() if each.is_file())[:MOST_FILES]
        except OSError:
            return []


def _number(field: Mapping[str, Any], key: str) -> float:
    """The value of a key of [field]; nan where it is no number."""
    value = field.get(key)
    return float(value) if isinstance(value, int | float) else math.nan


def _is_antenna(path: Path) -> bool:
    if path.suffix != ".toml":
        return False
    try:
        return "[parameters]" in path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return False
