"""A whole, verified recording from one that was cut or damaged."""

import os
from pathlib import Path

from mcap.writer import CompressionType, Writer

from fieldkit.errors import RecordingError
from fieldkit.recording.codec import encode_value
from fieldkit.recording.records import NO_INDEX, Contents, is_whole, walk
from fieldkit.recording.schema import HEADER, PROFILE
from fieldkit.recording.writer import close_chunk


def recover(path_in: Path, path_out: Path) -> list[str]:
    """Write everything intact in `path_in` to `path_out` as a whole, verified file; returns what is missing.

    `path_out` must not exist; it appears only once it is complete and has been read back.
    """
    if path_out.exists():
        raise RecordingError(f"{path_out}: exists already; name another file for the recovered recording")
    partial = path_out.with_name(f".{path_out.name}.part")
    try:
        problems, written = _copy(path_in, partial)
        if not problems and not is_whole(path_in):
            problems = [NO_INDEX]
        check = Contents()
        if not is_whole(partial) or sum(1 for _ in walk(partial, check)) != written or check.problems:
            raise RecordingError(f"{path_out}: did not read back as written; is the disk full or failing?")
        partial.replace(path_out)
    finally:
        partial.unlink(missing_ok=True)
    return problems


def _copy(path_in: Path, path_out: Path) -> tuple[list[str], int]:
    contents, written = Contents(), 0
    schemas: dict[int, int] = {0: 0}
    channels: dict[int, int] = {}
    path_out.parent.mkdir(parents=True, exist_ok=True)
    with path_out.open("wb") as stream:
        out = Writer(stream, chunk_size=64 * 1024, compression=CompressionType.ZSTD, enable_data_crcs=True)
        out.start(profile=PROFILE)
        for channel, message in walk(path_in, contents):
            if not written and channel.topic != HEADER.name and contents.header is not None:
                first = out.register_channel(HEADER.name, "json", 0)
                out.add_message(first, message.log_time, encode_value(contents.header), message.log_time)
                close_chunk(out)
                written += 1
            if channel.id not in channels:
                schema = contents.schemas.get(channel.schema_id)
                if schema is not None and schema.id not in schemas:
                    schemas[schema.id] = out.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = out.register_channel(
                    channel.topic,
                    channel.message_encoding,
                    schemas.get(channel.schema_id, 0),
                    channel.metadata,
                )
            out.add_message(
                channels[channel.id], message.log_time, message.data, message.publish_time, message.sequence
            )
            if channel.topic == HEADER.name:
                close_chunk(out)
            written += 1
        if not written:
            raise RecordingError(f"{path_in}: no intact message in it; nothing can be recovered")
        for item in contents.attachments:
            out.add_attachment(item.create_time, item.log_time, item.name, item.media_type, item.data)
        out.add_metadata("recovered", {"from": path_in.name, "missing": "; ".join(contents.problems)})
        out.finish()
        stream.flush()
        os.fsync(stream.fileno())
    return contents.problems, written
