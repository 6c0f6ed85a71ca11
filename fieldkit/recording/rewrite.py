"""A new, verified recording made of an old one's intact messages: what recovery, redaction and merging share."""

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mcap.records import Channel, Message
from mcap.writer import CompressionType, Writer

from fieldkit.errors import RecordingError
from fieldkit.recording.codec import encode_value
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

    `path_out` must not exist; it appears only once it is complete and has been read back.
    """
    if path_out.exists():
        raise RecordingError(f"{path_out}: exists already; name another file")
    partial = path_out.with_name(f".{path_out.name}.part")
    contents = Contents()
    try:
        path_out.parent.mkdir(parents=True, exist_ok=True)
        with partial.open("wb") as stream:
            written = _copy(path_in, stream, contents, edit, edit_header, keep_attachments, metadata)
            stream.flush()
            os.fsync(stream.fileno())
        problems = contents.problems
        if not problems and not is_whole(path_in):
            problems = [NO_INDEX]
        verify(partial, path_out, written)
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


def _copy(
    path_in: Path,
    stream: Any,
    contents: Contents,
    edit: EditMessage,
    edit_header: EditHeader,
    keep_attachments: bool,
    metadata: tuple[str, dict[str, str]] | None,
) -> int:
    out = Writer(stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD, enable_data_crcs=True)
    out.start(profile=PROFILE)
    schemas: dict[int, int] = {0: 0}
    channels: dict[int, int] = {}
    topics: list[list[Any]] = []
    header: dict[str, Any] | None = None
    written = 0

    def begin(found: dict[str, Any], channel: int, at_ns: int) -> None:
        """The header goes first, in a chunk of its own."""
        nonlocal header, written
        header = edit_header(found)
        out.add_message(channel, at_ns, encode_value(header), at_ns)
        close_chunk(out)
        written += 1

    for channel, message in walk(path_in, contents):
        if header is None and channel.topic != HEADER.name and contents.header is not None:
            number = out.register_channel(HEADER.name, "json", 0)
            topics.append([number, HEADER.name])
            begin(contents.header, number, message.log_time)
        is_header = channel.topic == HEADER.name
        data = message.data if is_header else edit(channel, message)
        if data is None or (is_header and header is not None):
            continue
        if channel.id not in channels:
            schema = contents.schemas.get(channel.schema_id)
            if schema is not None and schema.id not in schemas:
                schemas[schema.id] = out.register_schema(schema.name, schema.encoding, schema.data)
            channels[channel.id] = out.register_channel(
                channel.topic, channel.message_encoding, schemas.get(channel.schema_id, 0), channel.metadata
            )
            topics.append([channels[channel.id], channel.topic])
        if is_header:
            begin(json.loads(data), channels[channel.id], message.log_time)
            continue
        out.add_message(channels[channel.id], message.log_time, data, message.publish_time, message.sequence)
        written += 1
    if not written:
        raise RecordingError(f"{path_in}: no intact message in it; nothing can be recovered")
    if header is not None:
        attach_header(out, header, topics)
    for item in contents.attachments if keep_attachments else ():
        if item.name not in (HEADER_COPY, "mission.toml", "antenna.toml"):
            out.add_attachment(item.create_time, item.log_time, item.name, item.media_type, item.data)
    if metadata is not None:
        name, values = metadata
        out.add_metadata(name, values | {"missing": "; ".join(contents.problems)})
    out.finish()
    return written


def attach_header(out: Writer, header: dict[str, Any], topics: list[list[Any]]) -> None:
    """The header's second copy with the number of each channel, and what other tools may look for."""
    copy = encode_value({"header": header, "channels": topics})
    out.add_attachment(0, 0, HEADER_COPY, "application/json", copy)
    out.add_metadata("fieldkit", {key: str(header.get(key, "")) for key in ("schema", "fieldkit")})
    for name in ("mission_toml", "antenna_toml"):
        if header.get(name):
            text = str(header[name]).encode()
            out.add_attachment(0, 0, name.replace("_", "."), "application/toml", text)
