"""A collection as a recording: everything heard as it came, and the places as they were counted.

A recording is never written over, so each run of `calibrate collect` starts its own; the places collected
before are noted at its beginning, and the newest alone is enough.
"""

import json
from dataclasses import asdict
from pathlib import Path

from calibration.collection import Packet, Place
from fieldkit.messages import Pose, ReceiverState, RssReading
from fieldkit.recording import Recording, RecordingWriter

KIND = "calibration"
_PLACE, _REMOVED = "place ", "removed the last place"


class CollectLog:
    """Writes to an open recording."""

    def __init__(self, writer: RecordingWriter) -> None:
        self._writer = writer
        self._number = 0

    def event(self, log_time_ns: int, event: RssReading | ReceiverState | Pose) -> None:
        self._writer.event(self._number, log_time_ns, event)
        self._number += 1

    def place(self, place: Place) -> None:
        self._writer.note("info", _PLACE + json.dumps(asdict(place)))
        self._writer.flush()

    def removed(self) -> None:
        self._writer.note("info", _REMOVED)


def metadata(source: str, period_s: float, packets: int) -> dict[str, object]:
    """What the recording's header says of the collection."""
    return {"kind": KIND, "beacon": {"source": source, "period_s": period_s, "packets": packets}}


def places_of(recording: Recording) -> list[Place]:
    """The places in a collection's recording, removed ones left out; empty for another kind of recording."""
    places: list[Place] = []
    if recording.metadata.get("kind") != KIND:
        return places
    for _, note in recording.notes():
        if note.text == _REMOVED and places:
            places.pop()
        elif note.text.startswith(_PLACE):
            values = json.loads(note.text.removeprefix(_PLACE))
            packets = tuple(Packet(**packet) for packet in values.pop("packets"))
            places.append(Place(**values, packets=packets))
    return places


def free_path(path: Path) -> Path:
    """`path`, or path-2, path-3 ... where there is one already."""
    number, free = 1, path
    while free.exists():
        number += 1
        free = path.with_stem(f"{path.stem}-{number}")
    return free
