"""Writing a mission's recording: chunks of 64 KiB, closed by a timer: a killed mission loses under 1 s.

The caller gives the time (`log_time_ns`, the moment at the inbox); nothing here reads a clock. A clock that steps is
noted in the recording and stalls nothing. A disk that fails stops the recording and says so in `failure`; it never
stops the mission. A long recording goes on in numbered parts (`mission.2.mcap`), each whole in itself.
"""

import contextlib
import logging
import os
import secrets
import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import register_schema

from fieldkit import __version__
from fieldkit.errors import RecordingError
from fieldkit.geo import FieldFrame
from fieldkit.messages import Command, Detection, Event, FloatArray, Plan, Pose, SourceEstimate
from fieldkit.recording import codec, viewer
from fieldkit.recording.disk import DiskSync
from fieldkit.recording.made_with import software
from fieldkit.recording.schema import (
    BY_KIND,
    HEADER,
    HEADER_COPY,
    PROFILE,
    RESULT,
    SCHEMA,
    TOPICS,
    BeliefDigest,
    Level,
    Note,
    schema_text,
)

logger = logging.getLogger(__name__)

CHUNK_BYTES = 64 * 1024
CHUNK_NS = 500_000_000
"""A chunk is closed this long after its first message: with a tick every 0.2 s, under 1 s can be lost."""
SYNC_NS = 5_000_000_000
"""Time between calls of fsync, which is what survives a power cut."""
EARLY_BYTES = 2_000_000_000
"""With less space than this the operator is warned, while there is time to make some."""
LOW_BYTES = 500_000_000
"""With less space than this raw bytes, the largest part, are no longer recorded."""
VIEW_NS = 200_000_000
"""Robots are shown at most this often; the exact poses are all in `/in/pose`."""
FIX_NS = 1_000_000_000
"""And on the map of the Earth at most this often."""
STEP_BACK_NS = 1_000_000_000
STEP_AHEAD_NS = 10_000_000_000
"""Longer than a mission is ever without a tick: the clock has been set."""
_UINT64 = 2**64 - 1


def part_path(path: Path, part: int) -> Path:
    """The file of one part of the recording that begins in `path`: mission.mcap, mission.2.mcap, ..."""
    return path if part == 1 else path.with_name(f"{path.stem}.{part}{path.suffix}")


def close_chunk(writer: Writer) -> None:
    """End the chunk in hand and give everything to the operating system: survives a kill, not a power cut.

    The one place that needs the library's chunk finaliser (public as `flush` since mcap 1.6).
    """
    writer.flush()  # type: ignore[no-untyped-call]


class RecordingWriter:
    """One open recording. Use as a context manager or call `close`."""

    def __init__(
        self,
        path: Path,
        *,
        mission_toml: str = "",
        antenna_toml: str = "",
        metadata: Mapping[str, Any] | None = None,
        frame: FieldFrame | None = None,
        start_ns: int = 0,
        rotate_bytes: int | None = None,
    ) -> None:
        """Start the file at `path`, which must not exist. `metadata`: what JSON can carry, seeds included.

        `frame` adds latitude and longitude for map viewers. A file that has grown to `rotate_bytes` is finished,
        and the recording goes on in the next part.
        """
        self.path = path
        self.failure = ""
        """Why recording stopped; empty while it runs."""
        self._frame = frame
        self._rotate_bytes = rotate_bytes
        self._part = 0
        self._shown_ns: dict[str, int] = {}
        self._chunk_ns: int | None = None
        self._now_ns = self._sync_ns = start_ns
        self._events = False
        self._closed = False
        self._warned_of_space = False
        self._short_of_space = False
        self._disk = DiskSync()
        self._header = {
            "schema": SCHEMA,
            "fieldkit": __version__,
            "software": software(),
            "metadata": dict(metadata or {}),
            "mission_toml": mission_toml,
            "antenna_toml": antenna_toml,
            "recording": secrets.token_hex(8),
        }
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._open_part(1)
        except FileExistsError:
            raise RecordingError(f"{path}: there is a recording already; it is never overwritten") from None
        except OSError as error:
            raise RecordingError(f"{path}: cannot be written: {error.strerror}") from error
        self._guard(lambda: self._begin(self._header | {"part": 1}))

    def _open_part(self, part: int) -> None:
        self._stream = part_path(self.path, part).open("xb")
        self._mcap = Writer(
            self._stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD, enable_data_crcs=True
        )
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._chunk_ns = None
        self._part = part

    def _rotate(self) -> None:
        """Finish this part, and go on in the next."""
        self._finish()
        self._stream.close()
        self._open_part(self._part + 1)
        self._begin(self._header | {"part": self._part})

    def _begin(self, header: dict[str, Any]) -> None:
        """Everything needed to understand the rest goes first, and to disk at once."""
        self._mcap.start(profile=PROFILE)
        for topic in TOPICS:
            schema_id = self._mcap.register_schema(topic.schema, "jsonschema", schema_text(topic))
            self._channels[topic.name] = self._mcap.register_channel(topic.name, "json", schema_id)
        self._add(HEADER.name, codec.encode_value(header), 0, self._now_ns, self._now_ns)
        close_chunk(self._mcap)
        # A second copy: one bad byte in the first chunk must not make a whole mission unreadable.
        copy = {"header": header, "channels": [[number, name] for name, number in self._channels.items()]}
        self._mcap.add_attachment(0, self._now_ns, HEADER_COPY, "application/json", codec.encode_value(copy))
        # And for other tools; ours read what a CRC protects.
        self._mcap.add_metadata("fieldkit", {key: str(header[key]) for key in ("schema", "fieldkit")})
        for name in ("mission_toml", "antenna_toml"):
            if header[name]:
                text = header[name].encode()
                self._mcap.add_attachment(0, self._now_ns, name.replace("_", "."), "application/toml", text)
        self._sync()

    def event(self, inbox_number: int, log_time_ns: int, event: Event) -> None:
        """One event, as it left the inbox. `inbox_number` counts up by one: a gap is reported as loss."""
        self._mind_the_clock(log_time_ns)
        self._write(BY_KIND[type(event)].name, codec.encode(event), inbox_number, log_time_ns, event.t_ns)
        if (
            isinstance(event, Pose)
            and abs(log_time_ns - self._shown_ns.get(event.robot, -VIEW_NS)) >= VIEW_NS
        ):
            self._shown_ns[event.robot] = log_time_ns
            self._show(event, log_time_ns)

    def command(
        self,
        inbox_number: int,
        log_time_ns: int,
        command: Command,
        origin: Literal["kernel", "safety"] = "kernel",
    ) -> None:
        """One command that event `inbox_number` led to: what the kernel asked, or safety let pass."""
        data = codec.encode(command, origin=origin)
        self._write(BY_KIND[type(command)].name, data, inbox_number, log_time_ns, command.t_ns)

    def detection(self, inbox_number: int, log_time_ns: int, detection: Detection) -> None:
        """A transmission as the whole team heard it."""
        self._write("/engine/detection", codec.encode(detection), inbox_number, log_time_ns, detection.t_ns)

    def sources(self, inbox_number: int, log_time_ns: int, sources: Sequence[SourceEstimate]) -> None:
        """All sources believed in at this moment."""
        data = codec.encode_value({"sources": list(sources)})
        self._write("/engine/sources", data, inbox_number, log_time_ns, log_time_ns)
        self._view("/view/sources", viewer.scene, log_time_ns, sources, log_time_ns=log_time_ns)

    def plan(self, inbox_number: int, log_time_ns: int, plan: Plan) -> None:
        """A new plan."""
        self._write("/engine/plan", codec.encode(plan), inbox_number, log_time_ns, plan.t_ns)

    def belief(
        self,
        inbox_number: int,
        log_time_ns: int,
        values: FloatArray | None = None,
        *,
        cell_m: float = 1.0,
        origin_m: tuple[float, float] = (0.0, 0.0),
        name: str = "p",
        digest: str = "",
        numbers: Mapping[str, float] | None = None,
    ) -> None:
        """The belief over the field (n_north, n_east), row 0 south, kept as float32 for viewers and report.

        `digest` is the belief's exact hash, which replay compares; `values` may be left out.
        """
        said = BeliefDigest(name=name, digest=digest, values=dict(numbers or {}))
        self._write("/engine/belief", codec.encode(said), inbox_number, log_time_ns, log_time_ns)
        if values is not None:
            arguments = (log_time_ns, values, cell_m, origin_m, name)
            self._view(f"/view/belief/{name}", viewer.grid, *arguments, log_time_ns=log_time_ns)

    def result(self, inbox_number: int, log_time_ns: int, result: Mapping[str, Any]) -> None:
        """How the mission ended: any plain values. On disk when this returns."""
        self._write(RESULT.name, codec.encode_value(dict(result)), inbox_number, log_time_ns, log_time_ns)
        self.flush()
        self._guard(self._disk.wait)

    def note(self, level: Level, text: str, log_time_ns: int = 0) -> None:
        """A line for whoever reads the log later; without a time, the time of the last message."""
        at_ns = log_time_ns or self._now_ns
        self._write(BY_KIND[Note].name, codec.encode(Note(level, text)), 0, at_ns, at_ns)
        self._view("/view/log", viewer.log, at_ns, level, text, log_time_ns=at_ns)

    def raw(self, log_time_ns: int, link: str, data: bytes, heard_ns: int | None = None) -> None:
        """Bytes of a link as they came, on topic `/raw/<link>`. Signing keys must never be passed here."""
        topic = f"/raw/{link}"

        def add() -> None:
            if self._short_of_space:
                return
            if topic not in self._channels:
                self._channels[topic] = self._mcap.register_channel(topic, "application/octet-stream", 0)
            self._add(topic, data, 0, log_time_ns, log_time_ns if heard_ns is None else heard_ns)

        self._guard(add)

    def attach(self, name: str, data: bytes, media_type: str = "application/octet-stream") -> None:
        """A file to carry along, such as a picture of the field."""
        self._guard(lambda: self._mcap.add_attachment(0, self._now_ns, name, media_type, data))

    def maybe_flush(self, now_ns: int) -> None:
        """Close the chunk if its time has come; call this where no message may come for a while."""
        self._now_ns = max(self._now_ns, now_ns)
        self._guard(self._keep_time)

    def flush(self) -> None:
        """Everything so far to the disk itself, without waiting for it. For moments that matter: a source found."""
        self._guard(self._sync)

    def close(self) -> None:
        """Finish the file: index, statistics, CRC. Closing twice is harmless."""
        if self._closed:
            return
        self._guard(self._finish)
        self._closed = True
        # A disk that failed before may fail once more for what is still buffered.
        with contextlib.suppress(OSError):
            self._stream.close()
        self._disk.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _mind_the_clock(self, log_ns: int) -> None:
        """Note a clock that was set, and measure from its new time: chunks must be closed all the same."""
        step_ns = log_ns - self._now_ns
        if self._events and not self.failure and (step_ns < -STEP_BACK_NS or step_ns > STEP_AHEAD_NS):
            self._guard(self._sync)
            self._now_ns = self._sync_ns = log_ns
            way = "ahead" if step_ns > 0 else "back"
            logger.warning("%s: the clock stepped %s by %.1f s", self.path, way, abs(step_ns) * 1e-9)
            self.note("warning", f"the clock stepped {way} by {abs(step_ns) * 1e-9:.1f} s", log_ns)
        self._events = True

    def _show(self, pose: Pose, log_time_ns: int) -> None:
        self._view(f"/view/pose/{pose.robot}", viewer.pose_in_frame, pose, log_time_ns=log_time_ns)
        self._view("/tf", viewer.transform, pose, log_time_ns=log_time_ns)
        topic = f"/view/fix/{pose.robot}"
        if self._frame is not None and abs(log_time_ns - self._shown_ns.get(topic, -FIX_NS)) >= FIX_NS:
            self._shown_ns[topic] = log_time_ns
            self._view(topic, viewer.location_fix, pose, self._frame, log_time_ns=log_time_ns)

    def _write(self, topic: str, data: bytes, sequence: int, log_ns: int, publish_ns: int) -> None:
        self._guard(lambda: self._add(topic, data, sequence, log_ns, publish_ns))

    def _view(self, topic: str, build: Callable[..., Any], *arguments: Any, log_time_ns: int) -> None:
        def add() -> None:
            message = build(*arguments)
            if topic not in self._channels:
                kind = type(message).DESCRIPTOR.full_name
                if kind not in self._schemas:
                    self._schemas[kind] = register_schema(self._mcap, type(message))
                self._channels[topic] = self._mcap.register_channel(topic, "protobuf", self._schemas[kind])
            self._add(topic, message.SerializeToString(), 0, log_time_ns, log_time_ns)

        self._guard(add)

    def _add(self, topic: str, data: bytes, sequence: int, log_ns: int, publish_ns: int) -> None:
        self._mcap.add_message(
            self._channels[topic], log_ns, data, min(max(0, publish_ns), _UINT64), sequence=sequence % 2**32
        )
        self._now_ns = max(self._now_ns, log_ns)
        if self._chunk_ns is None:
            self._chunk_ns = log_ns
        self._keep_time()

    def _keep_time(self) -> None:
        if self._now_ns - self._sync_ns >= SYNC_NS:
            self._sync()
            if self._rotate_bytes is not None and self._stream.tell() >= self._rotate_bytes:
                self._rotate()
        elif self._chunk_ns is not None and self._now_ns - self._chunk_ns >= CHUNK_NS:
            close_chunk(self._mcap)
            self._chunk_ns = None

    def _sync(self) -> None:
        close_chunk(self._mcap)
        self._stream.flush()
        self._disk.ask(self._stream.fileno())
        self._chunk_ns, self._sync_ns = None, self._now_ns
        self._look_at_space()

    def _look_at_space(self) -> None:
        """Warn once early, and once when raw bytes are no longer recorded; the recording says so too."""
        free = shutil.disk_usage(self.path.parent).free
        if free < LOW_BYTES and not self._short_of_space:
            self._short_of_space = self._warned_of_space = True
            self._warn_of_space(free, "raw bytes are no longer recorded, everything else is")
        elif free < EARLY_BYTES and not self._warned_of_space:
            self._warned_of_space = True
            self._warn_of_space(
                free, f"below {LOW_BYTES // 1_000_000} MB raw bytes will no longer be recorded"
            )

    def _warn_of_space(self, free: int, text: str) -> None:
        said = f"only {free // 1_000_000} MB are free: {text}"
        logger.warning("%s: %s", self.path, said)
        self._add(BY_KIND[Note].name, codec.encode(Note("warning", said)), 0, self._now_ns, self._now_ns)

    def _finish(self) -> None:
        self._mcap.finish()  # type: ignore[no-untyped-call]
        self._stream.flush()
        self._disk.wait()
        os.fsync(self._stream.fileno())

    def _guard(self, action: Callable[[], None]) -> None:
        """A full or failing disk ends the recording, not the mission: what was written stays readable."""
        if self.failure or self._closed:
            return
        try:
            action()
        except OSError as error:
            self.failure = f"{self.path}: recording stopped: {error.strerror or error}"
            logger.error("%s. The mission goes on without it; free some space before the next.", self.failure)
