"""Reading a recording, whole or cut: metadata at once, everything else in one pass in file order."""

import json
import logging
from collections import Counter
from collections.abc import Container, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap.records import Channel, Message

from fieldkit.errors import RecordingError, os_words
from fieldkit.messages import Command, Detection, Event, FloatArray, Plan, SourceEstimate, Tick
from fieldkit.recording import codec
from fieldkit.recording.records import NO_INDEX, Contents, is_whole, walk
from fieldkit.recording.schema import (
    BY_NAME,
    HEADER,
    OLDEST_SCHEMA,
    RESULT,
    SCHEMA,
    BeliefDigest,
    Note,
    Topic,
)
from fieldkit.recording.writer import part_path

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Item:
    """One message of ours. `value` is what `kind` (the topic's family) says; `origin` only for commands."""

    kind: str
    inbox_number: int
    log_time_ns: int
    value: Any
    origin: str = ""


@dataclass(frozen=True, slots=True)
class BeliefGrid:
    """The belief over the field as kept for viewers: float32 precision, (n_north, n_east), row 0 south."""

    log_time_ns: int
    name: str
    values: FloatArray
    cell_m: float
    origin_m: tuple[float, float]


@dataclass(slots=True)
class Step:
    """One event with what it led to."""

    inbox_number: int
    log_time_ns: int
    event: Event
    commands: list[tuple[str, Command]] = field(default_factory=list)
    """("kernel" or "safety", command), in their order."""
    digest: str = ""
    """The belief's hash after it, where one was recorded."""
    known: bool = True
    """Whether the recording goes on far enough to hold all that it led to."""


@dataclass(slots=True)
class Recording:
    """A recording that has been opened. Each method makes its own pass through the file."""

    path: Path
    complete: bool
    """Finished by its writer, and both CRCs over the file agree."""
    problems: list[str]
    """What is missing or damaged, each in words; empty for a complete file."""
    fieldkit_version: str
    metadata: dict[str, Any]
    mission_toml: str
    antenna_toml: str
    software: dict[str, str] = field(default_factory=dict)
    """Versions it was made with: fieldkit, python, machine, numpy, scipy, numba."""
    seconds_missing: float = 0.0
    """Time between the neighbours of lost events; what a cut took off the end is not in it (under 1 s)."""
    counts: Counter[str] = field(default_factory=Counter)
    """Messages per topic; filled for a damaged file or by `summary`."""
    ended: dict[str, Any] | None = None
    """The result, once some pass has come across it."""
    parts: list[Path] = field(default_factory=list)
    """The files of a recording that was rotated, in order; of any other the one file."""

    @property
    def missing(self) -> str:
        """What is missing, as one sentence; empty for a complete file."""
        return "; ".join(self.problems)

    def items(self, *kinds: str) -> Iterator[Item]:
        """Everything of ours in file order, or only some kinds: event, command, detection, sources, plan,
        belief, note, result.

        Raises `RecordingError` where a message cannot be understood, naming it.
        """
        wanted = {
            name: topic
            for name, topic in BY_NAME.items()
            if topic is not HEADER and (not kinds or topic.family in kinds)
        }
        for channel, message in _walk_all(self.parts, wanted):
            topic = wanted[channel.topic]
            value, origin = self._decode(topic, message.data, message.sequence)
            yield Item(topic.family, message.sequence, message.log_time, value, origin)

    def steps(self) -> Iterator[Step]:
        """Each event with what it led to: what replay feeds to the kernel and compares with.

        What an event led to may stand well behind it: events are recorded as they arrive, also while the kernel is
        busy. Events that came after the mission's end, which nobody stepped, are left out.
        """
        led: dict[int, Step] = {}
        last: int | None = None
        # Where events are missing, what the last ones before them led to may be missing with them.
        until: int | None = None
        following: int | None = None
        for item in self.items("command", "belief", "result", *(() if self.complete else ("event",))):
            if item.kind == "event":
                if until is None and following not in (None, item.inbox_number):
                    until = max(led, default=0) - 1
                following = item.inbox_number + 1
                continue
            if item.kind == "result":
                last, self.ended = item.inbox_number, item.value
                continue
            step = led.setdefault(item.inbox_number, Step(item.inbox_number, 0, Tick(0)))
            if item.kind == "command":
                step.commands.append((item.origin, item.value))
            elif item.value.digest:
                step.digest = item.value.digest
        # Nothing is known of what the last events led to, unless the mission came to its end.
        known = max(led, default=0) - 1 if last is None else last
        known = known if until is None else min(known, until)
        for item in self.items("event"):
            if last is not None and item.inbox_number > last:
                return
            step = led.get(item.inbox_number) or Step(item.inbox_number, 0, item.value)
            step.log_time_ns, step.event, step.known = (
                item.log_time_ns,
                item.value,
                item.inbox_number <= known,
            )
            yield step

    def events(self) -> Iterator[tuple[int, int, Event]]:
        """(inbox number, log time in ns, event): exactly what entered the kernel, in that order."""
        for item in self.items("event"):
            yield item.inbox_number, item.log_time_ns, item.value

    def commands(self) -> Iterator[tuple[int, int, str, Command]]:
        """(inbox number of the event that led to it, log time in ns, "kernel" or "safety", command)."""
        for item in self.items("command"):
            yield item.inbox_number, item.log_time_ns, item.origin, item.value

    def detections(self) -> Iterator[tuple[int, int, Detection]]:
        """(inbox number, log time in ns, detection)."""
        for item in self.items("detection"):
            yield item.inbox_number, item.log_time_ns, item.value

    def sources(self) -> Iterator[tuple[int, int, list[SourceEstimate]]]:
        """(inbox number, log time in ns, all sources believed in then)."""
        for item in self.items("sources"):
            yield item.inbox_number, item.log_time_ns, item.value

    def plans(self) -> Iterator[tuple[int, int, Plan]]:
        """(inbox number, log time in ns, plan)."""
        for item in self.items("plan"):
            yield item.inbox_number, item.log_time_ns, item.value

    def digests(self) -> Iterator[tuple[int, int, BeliefDigest]]:
        """(inbox number, log time in ns, the belief's hash): what a replay has to reproduce."""
        for item in self.items("belief"):
            yield item.inbox_number, item.log_time_ns, item.value

    def notes(self) -> Iterator[tuple[int, Note]]:
        """(log time in ns, note)."""
        for item in self.items("note"):
            yield item.log_time_ns, item.value

    def result(self) -> dict[str, Any] | None:
        """How the mission ended; None where it was cut before its end."""
        if self.ended is not None:
            return self.ended
        if self.complete:
            data = _by_index(self.parts[-1], RESULT.name)
            return None if data is None else self._decode(RESULT, data, 0)[0]
        return next((item.value for item in self.items("result")), None)

    def beliefs(self, name: str = "p") -> Iterator[BeliefGrid]:
        """The belief over the field as time goes on."""
        from foxglove_schemas_protobuf.Grid_pb2 import Grid

        from fieldkit.recording.viewer import grid_values

        for _, message in _walk_all(self.parts, {f"/view/belief/{name}"}):
            values, cell_m, origin_m, called = grid_values(Grid.FromString(message.data))
            yield BeliefGrid(message.log_time, called, values, cell_m, origin_m)

    def summary(self) -> dict[str, Any]:
        """Duration, counts per topic, whether complete and what is missing: plain values.

        A complete file's own index answers at once; a damaged one is walked.
        """
        looks = [(_indexed if self.complete else _counted)(part) for part in self.parts]
        self.counts = sum((counts for counts, _, _ in looks), Counter())
        first = min((first for _, first, _ in looks if first is not None), default=None)
        last = max((last for _, _, last in looks if last is not None), default=None)
        return {
            "recording": str(self.path),
            "bytes": sum(part.stat().st_size for part in self.parts),
            "parts": [str(part) for part in self.parts],
            "complete": self.complete,
            "missing": self.missing,
            "seconds_missing": round(self.seconds_missing, 3),
            "start_ns": first,
            "duration_s": 0.0 if first is None or last is None else (last - first) * 1e-9,
            "counts": dict(sorted(self.counts.items())),
            "fieldkit": self.fieldkit_version,
            "software": self.software,
            "metadata": self.metadata,
        }

    def _decode(self, topic: Topic, data: bytes, number: int) -> tuple[Any, str]:
        try:
            values = json.loads(data)
            if topic.family == "sources":
                return [codec.decode(SourceEstimate, _of_today(source)) for source in values["sources"]], ""
            if topic.kind is None:
                return values, ""
            origin = values.pop("origin", "") if topic.family == "command" else ""
            return codec.decode(topic.kind, values), origin
        except (KeyError, TypeError, ValueError) as error:
            raise RecordingError(
                f"{self.path}: message {number} on {topic.name} cannot be understood ({error}); "
                f"it was written by fieldkit {self.fieldkit_version}: read it with that version"
            ) from error


IN_A_RUN = "mission.mcap"
"""The recording in the folder of a run."""


def recording_at(path: Path) -> Path:
    """The file of a recording, or of the one in the folder of a run. Raises `RecordingError` where there is none."""
    if path.is_dir() and (path / IN_A_RUN).is_file():
        path = path / IN_A_RUN
    if not path.is_file():
        raise RecordingError(f"{path}: no such recording; name the mission.mcap in a folder under runs/")
    return path


def open_recording(path: Path | str) -> Recording:
    """Open a recording, or the one in the folder of a run.

    A cut or damaged one is opened too: it says what is missing and warns once.

    Raises `RecordingError` where the file is missing, closed to us, empty, not a recording, from a newer schema, or cut
    before its first chunk was on disk.
    """
    path = recording_at(Path(path))
    try:
        return _opened(path)
    except RecordingError:
        raise
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {os_words(error)}") from error


def _opened(path: Path) -> Recording:
    header = _header(path)
    parts, unread = _parts(path, header)
    if header.get("part", 1) != 1:
        unread = [f"is part {header['part']} of a recording: what came before is not in it", *unread]
    whole = not unread and all(map(is_whole, parts))
    recording = Recording(
        path=path,
        complete=whole,
        problems=[],
        fieldkit_version=str(header.get("fieldkit", "")),
        metadata=header.get("metadata", {}),
        mission_toml=header.get("mission_toml", ""),
        antenna_toml=header.get("antenna_toml", ""),
        software=header.get("software", {}),
        parts=parts,
    )
    if not whole:
        _examine(recording)
        recording.problems = [*unread, *recording.problems]
        logger.warning("%s: not complete: %s", path, recording.missing)
    return recording


def parts_of(path: Path) -> tuple[list[Path], list[str]]:
    """The files of the recording that begins in `path`, and what is wrong with those that should be there."""
    try:
        return _parts(path, _header(path))
    except RecordingError:  # whoever reads it will say why
        return [path], []


def is_later_part(path: Path) -> bool:
    """Whether this is a mission.2.mcap beside its mission.mcap."""
    stem, dot, number = path.stem.rpartition(".")
    return bool(dot) and number.isdecimal() and path.with_name(stem + path.suffix).exists()


def _parts(path: Path, header: dict[str, Any]) -> tuple[list[Path], list[str]]:
    """The file and those the same recording went on in; what is wrong with those that should be there."""
    parts, number = [path], int(header.get("part", 1))
    first = path if number == 1 else path.with_name(path.name.replace(f".{number}{path.suffix}", path.suffix))
    later = [n for n in _part_numbers(first) if n > number]
    if not header.get("recording"):
        return parts, []
    for following in (part_path(first, n) for n in range(number + 1, max(later, default=0) + 1)):
        try:
            if _header(following).get("recording") != header["recording"]:
                return parts, [
                    f"{following.name} is of another recording; what came there and after is missing"
                ]
        except (RecordingError, FileNotFoundError) as error:
            return parts, [f"{following.name} cannot be read ({error}); what came there and after is missing"]
        parts.append(following)
    return parts, []


def _part_numbers(first: Path) -> list[int]:
    """Numbers of the files that look like later parts."""
    start, end = f"{first.stem}.", first.suffix
    names = [
        path.name
        for path in first.parent.iterdir()
        if path.name.startswith(start) and path.name.endswith(end)
    ]
    numbers = (name[len(start) : -len(end)] for name in names)
    return sorted(int(number) for number in numbers if number.isdecimal())


def _walk_all(parts: list[Path], topics: Container[str] | None = None) -> Iterator[tuple[Channel, Message]]:
    for part in parts:
        yield from walk(part, Contents(), topics)


def _header(path: Path) -> dict[str, Any]:
    contents = Contents()
    header = None
    for channel, message in walk(path, contents):
        header = json.loads(message.data) if channel.topic == HEADER.name else contents.header
        if header is not None:
            break
    header = header or contents.header
    if header is None and contents.problems:
        raise RecordingError(
            f"{path}: its beginning cannot be read ({contents.problems[0]}); it is of no use"
        )
    if header is None:
        raise RecordingError(
            f"{path}: is MCAP but not a fieldkit recording (it has no {HEADER.name} message)"
        )
    schema = header.get("schema")
    made = f"it was written by fieldkit {header.get('fieldkit', 'of an unknown version')}"
    if not isinstance(schema, int) or schema > SCHEMA:
        raise RecordingError(
            f"{path}: recording schema {schema} is newer than this fieldkit knows ({SCHEMA}); {made}: "
            "update fieldkit"
        )
    if schema < OLDEST_SCHEMA:
        raise RecordingError(
            f"{path}: recording schema {schema} is older than this fieldkit reads ({OLDEST_SCHEMA}); {made}: "
            "read it with that version"
        )
    return header


def _by_index(path: Path, topic: str) -> bytes | None:
    """The last message on a topic of a complete file, by its index: without reading the rest."""
    with path.open("rb") as stream:
        found = [
            message.data for _, _, message in make_reader(stream, validate_crcs=True).iter_messages([topic])
        ]
    return found[-1] if found else None


def _indexed(path: Path) -> tuple[Counter[str], int | None, int | None]:
    """Messages per topic, first and last log time, from the index of a complete file."""
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None and summary.statistics is not None
    per_channel = summary.statistics.channel_message_counts
    counts = Counter({summary.channels[number].topic: count for number, count in per_channel.items()})
    # The first chunk holds the header alone, whose time is when the file was opened.
    chunks = sorted(summary.chunk_indexes, key=lambda index: index.chunk_start_offset)[1:]
    if not chunks:
        return counts, None, None
    return counts, min(c.message_start_time for c in chunks), max(c.message_end_time for c in chunks)


def _counted(path: Path) -> tuple[Counter[str], int | None, int | None]:
    """The same by walking through the file."""
    counts: Counter[str] = Counter()
    first = last = None
    for channel, message in walk(path, Contents()):
        counts[channel.topic] += 1
        if channel.topic != HEADER.name:
            first = message.log_time if first is None else min(first, message.log_time)
            last = message.log_time if last is None else max(last, message.log_time)
    return counts, first, last


def _examine(recording: Recording) -> None:
    """Find out what a damaged file lacks: broken chunks, and gaps in the inbox numbers."""
    gaps: list[str] = []
    number, at_ns, last_ns = None, 0, 0
    read = [(part, Contents()) for part in recording.parts]
    for channel, message in (pair for part, contents in read for pair in walk(part, contents)):
        topic = BY_NAME.get(channel.topic)
        recording.counts[channel.topic] += 1
        last_ns = max(last_ns, message.log_time)
        if topic is None or topic.family != "event":
            continue
        if number is not None and message.sequence != number + 1:
            lost_s = (message.log_time - at_ns) * 1e-9
            recording.seconds_missing += max(0.0, lost_s)
            gaps.append(f"events {number + 1} to {message.sequence - 1} are missing ({lost_s:.2f} s)")
        number, at_ns = message.sequence, message.log_time
    named = len(read) > 1
    problems = [f"{p.name}: {text}" if named else text for p, contents in read for text in contents.problems]
    recording.problems = [*problems, *gaps]
    if not recording.problems and not all(map(is_whole, recording.parts)):
        recording.problems.append(NO_INDEX)


def _of_today(source: dict[str, Any]) -> dict[str, Any]:
    """A recorded source in today's words: recordings of before 2026-12 call an inconsistent one doubtful."""
    return source | {"state": "inconsistent"} if source.get("state") == "doubtful" else source
