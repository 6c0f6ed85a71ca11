"""A new, verified recording made of an old one's intact messages: what recovery, redaction and merging share."""

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mcap.records import Attachment, Channel, Message
from mcap.writer import CompressionType, Writer

from fieldkit.errors import RecordingError
from fieldkit.recording.codec import encode_value
from fieldkit.recording.reader import parts_of, recording_at
from fieldkit.recording.records import NO_INDEX, Contents, is_whole, walk
from fieldkit.recording.schema import HEADER, HEADER_COPY, PROFILE
from fieldkit.recording.writer import CHUNK_BYTES, close_chunk

#: The bytes to write for a message; None leaves it out.
EditMessage = Callable[[Channel, Message], bytes | None]
EditHeader = Callable[[dict[str, Any]], dict[str, Any]]


def rewrite(
    path_in: Path,
    path_out: Path,
    *,
    edit: EditMessage = lambda _, message: message.data,
    edit_header: EditHeader = lambda header: header,
    keep_attachments: bool = True,
    metadata: tuple[str, dict[str, str]] | None = None,
) -> list[str]:
    """Write the intact messages of `path_in`, edited, to `path_out` as a whole, verified file; what is missing.

    A recording in parts becomes one file. `path_in` may be the folder of a run, as in `open_recording`.

    `path_out` must not exist; it appears only once it is complete and has been read back.
    """
    if path_out.exists():
        raise RecordingError(f"{path_out}: exists already; name another file")
    path_in = recording_at(path_in)
    partial = path_out.with_name(f".{path_out.name}.part")
    parts, problems = parts_of(path_in)
    try:
        path_out.parent.mkdir(parents=True, exist_ok=True)
        with partial.open("wb") as stream:
            copy = _Copy(stream, edit, edit_header)
            for part in parts:
                copy.take(part, named=len(parts) > 1)
            if not copy.written:
                raise RecordingError(f"{path_in}: no intact message in it; nothing can be recovered")
            copy.finish(keep_attachments, metadata)
            stream.flush()
            os.fsync(stream.fileno())
        problems += copy.problems
        if not problems and not all(map(is_whole, parts)):
            problems = [NO_INDEX]
        verify(partial, path_out, copy.written)
        partial.replace(path_out)
    except OSError as error:
        raise RecordingError(f"{path_out}: cannot be written: {error.strerror or error}") from error
    finally:
        partial.unlink(missing_ok=True)
    return problems


def verify(path: Path, final: Path, messages: int) -> None:
    """Raise `RecordingError` where a file that was just written is not whole or lacks messages."""
    check = Contents()
    if not is_whole(path) or sum(1 for _ in walk(path, check)) != messages or check.problems:
        raise RecordingError(f"{final}: did not read back as written; is the disk full or failing?")


class _Copy:
    """One new file in the making: messages of one recording, or of its parts one after the other."""

    def __init__(self, stream: Any, edit: EditMessage, edit_header: EditHeader) -> None:
        self._out = Writer(
            stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD, enable_data_crcs=True
        )
        self._out.start(profile=PROFILE)
        self._edit, self._edit_header = edit, edit_header
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._header: dict[str, Any] | None = None
        self._attachments: list[Attachment] = []
        self.written = 0
        self.problems: list[str] = []

    def take(self, path: Path, named: bool) -> None:
        """Everything intact of one file. `named`: problems are reported with the file's name."""
        contents = Contents()
        for channel, message in walk(path, contents):
            if self._header is None:
                if channel.topic == HEADER.name:
                    self._begin(json.loads(message.data), self._channel(channel, contents), message.log_time)
                elif contents.header is not None:  # the first chunk is damaged: there is a copy
                    number = self._out.register_channel(HEADER.name, "json", 0)
                    self._channels[HEADER.name] = number
                    self._begin(contents.header, number, message.log_time)
            if channel.topic == HEADER.name:
                continue
            data = self._edit(channel, message)
            if data is not None:
                number = self._channel(channel, contents)
                self._out.add_message(number, message.log_time, data, message.publish_time, message.sequence)
                self.written += 1
        self._attachments += contents.attachments
        self.problems += [f"{path.name}: {text}" if named else text for text in contents.problems]

    def finish(self, keep_attachments: bool, metadata: tuple[str, dict[str, str]] | None) -> None:
        """The header's copy, attachments, index."""
        if self._header is not None:
            attach_header(
                self._out, self._header, [[number, topic] for topic, number in self._channels.items()]
            )
        for item in self._attachments if keep_attachments else ():
            if item.name not in (HEADER_COPY, "mission.toml", "antenna.toml"):
                self._out.add_attachment(
                    item.create_time, item.log_time, item.name, item.media_type, item.data
                )
        if metadata is not None:
            name, values = metadata
            self._out.add_metadata(name, values | {"missing": "; ".join(self.problems)})
        self._out.finish()  # type: ignore[no-untyped-call]

    def _begin(self, found: dict[str, Any], channel: int, at_ns: int) -> None:
        """The header goes first, in a chunk of its own."""
        self._header = self._edit_header(found)
        self._out.add_message(channel, at_ns, encode_value(self._header), at_ns)
        close_chunk(self._out)
        self.written += 1

    def _channel(self, channel: Channel, contents: Contents) -> int:
        """The new file's number for a channel: parts may have numbered theirs differently."""
        if channel.topic not in self._channels:
            schema = contents.schemas.get(channel.schema_id)
            if schema is not None and schema.name not in self._schemas:
                self._schemas[schema.name] = self._out.register_schema(
                    schema.name, schema.encoding, schema.data
                )
            number = 0 if schema is None else self._schemas[schema.name]
            self._channels[channel.topic] = self._out.register_channel(
                channel.topic, channel.message_encoding, number, channel.metadata
            )
        return self._channels[channel.topic]


def attach_header(out: Writer, header: dict[str, Any], topics: list[list[Any]]) -> None:
    """The header's second copy with the number of each channel, and what other tools may look for."""
    copy = encode_value({"header": header, "channels": topics})
    out.add_attachment(0, 0, HEADER_COPY, "application/json", copy)
    out.add_metadata("fieldkit", {key: str(header.get(key, "")) for key in ("schema", "fieldkit")})
    for name in ("mission_toml", "antenna_toml"):
        if header.get(name):
            text = str(header[name]).encode()
            out.add_attachment(0, 0, name.replace("_", "."), "application/toml", text)
