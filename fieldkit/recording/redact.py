"""A recording that may be shown to others: without raw bytes, radio addresses, ports, and the field's place on Earth.

Everything the engine takes in stays as it was, so that a redacted recording replays to the same belief and commands.
"""

import hashlib
import json
import secrets
from pathlib import Path
from typing import Any

import tomlkit
from mcap.records import Channel, Message

from fieldkit.recording import codec
from fieldkit.recording.rewrite import rewrite

HIDDEN = "redacted"
_SECRET_KEYS = ("port", "address", "host", "url", "path", "file", "key", "serial")
"""Options of drivers that say whose devices these are, or where they are."""


def redact(path_in: Path, path_out: Path, *, keep_place: bool = False) -> dict[str, Any]:
    """Write `path_in` without what is nobody's business to `path_out`; how much was left out or changed.

    With `keep_place` latitude and longitude stay. Addresses in `frame_id` become words that are the same for the same
    address within this file only. Raises `RecordingError` where `path_out` exists.
    """
    salt = secrets.token_bytes(16)
    count = {"raw_messages": 0, "fixes": 0, "addresses": 0, "texts": 0}

    def edit(channel: Channel, message: Message) -> bytes | None:
        if channel.topic.startswith("/raw/"):
            count["raw_messages"] += 1
            return None
        if channel.topic.startswith("/view/fix/") and not keep_place:
            count["fixes"] += 1
            return None
        if channel.topic == "/in/reading":
            return _without_address(message.data, salt, count)
        if channel.topic in ("/in/vehicle", "/in/receiver", "/note"):
            return _without_text(message.data, channel.topic, count)
        # What a viewer shows of the notes would reveal it all the same.
        return None if channel.topic == "/view/log" else message.data

    def edit_header(header: dict[str, Any]) -> dict[str, Any]:
        mission = redacted_mission(str(header.get("mission_toml", "")), salt, keep_place)
        antenna = _redacted_antenna(str(header.get("antenna_toml", "")))
        kept = {key: value for key, value in header.get("metadata", {}).items() if key != "background"}
        return header | {"mission_toml": mission, "antenna_toml": antenna, "metadata": kept}

    rewrite(
        path_in,
        path_out,
        edit=edit,
        edit_header=edit_header,
        keep_attachments=False,
        metadata=("redacted", {"place": "kept" if keep_place else "removed"}),
    )
    return count


def redacted_mission(text: str, salt: bytes, keep_place: bool) -> str:
    """A mission file without ports, addresses and (unless kept) the field's place on Earth: it is put at 0, 0.

    The picture under the map goes too, by whose name its owner and the place may be known, and other people's maps.
    """
    document = tomlkit.parse(text)
    field = document.get("field")
    document.pop("maps", None)
    if field is not None:
        for key in ("background", "background_crs"):
            field.pop(key, None)
    if field is not None and not keep_place:
        for key in ("origin_lat_deg", "origin_lon_deg", "origin_alt_m"):
            if key in field:
                field[key] = 0.0
    for table in (*document.get("robot", ()), *document.get("positions", ())):
        _hide(table, salt)
    # Comments are dropped with the layout: a note beside a line may say what the line no longer does.
    return tomlkit.dumps(document.unwrap())


def _redacted_antenna(text: str) -> str:
    document = tomlkit.parse(text)
    if "file" in document.get("data", {}):
        document["data"]["file"] = HIDDEN
    return tomlkit.dumps(document.unwrap())


def _hide(table: Any, salt: bytes) -> None:
    for key, value in list(table.items()):
        if isinstance(value, dict):
            _hide(value, salt)
        elif isinstance(value, str) and any(word in key for word in _SECRET_KEYS):
            # Distinct ones stay distinct: a mission with two radios on one port is not a mission.
            table[key] = f"{HIDDEN}-{_alias(f'{key}={value}', salt)}"


def _alias(text: str, salt: bytes) -> str:
    """The same word for the same text, within one file: the salt is kept nowhere."""
    return hashlib.sha256(salt + text.encode()).hexdigest()[:12]


def _without_address(data: bytes, salt: bytes, count: dict[str, int]) -> bytes:
    values = json.loads(data)
    if not values.get("frame_id"):
        return data
    count["addresses"] += 1
    values["frame_id"] = _alias(str(values["frame_id"]), salt)
    return codec.encode_value(values)


def _without_text(data: bytes, topic: str, count: dict[str, int]) -> bytes:
    """Free text of devices and drivers, which may name them; our own phases and finds are kept."""
    values = json.loads(data)
    key = {"/in/vehicle": "text", "/in/receiver": "reason", "/note": "text"}[topic]
    if not values.get(key) or (topic == "/note" and values.get("level") == "info"):
        return data
    count["texts"] += 1
    values[key] = HIDDEN
    return codec.encode_value(values)
