"""MAVLink 2 signing: frames signed on the way out, and verified BEFORE they are decoded on the way in.

pymavlink's own check stores a stream's time stamp before it has verified the signature: one forged frame with
a time far ahead locks the genuine sender out for ever. Here a stream's state changes only after its signature
was found good. Layout, https://mavlink.io/en/guide/message_signing.html: link id, 6 bytes of time (10 us from
2015 on), 6 bytes of SHA-256 over key, frame, link id and time.
"""

import hashlib
import hmac
import os
import stat
from collections.abc import Callable
from pathlib import Path

from drivers.mavlink.wire import checksum
from fieldkit.errors import ConfigError
from fieldkit.files import write_whole

EPOCH_NS = 1_420_070_400 * 1_000_000_000
"""1 January 2015, UTC: where signing time starts."""
UNIT_NS = 10_000
SIGNED = 0x01
"""Bit in the incompatibility flags of a signed frame."""
SIGNATURE_SIZE = 13
RADIO_STATUS = 109
"""The one message taken unsigned: telemetry radios make it themselves and have no key."""
NEW_STREAM_BEHIND = 6_000_000
"""A stream not heard before may be this much (a minute) behind the newest time known."""
MAX_STREAMS = 16
"""Streams remembered, as in the C library: more would be memory for whoever has the key and nobody else."""
SAVE_EVERY = 6_000_000


class Signer:
    """One key: signs what goes out, verifies what comes in. Time only moves forward, restarts included."""

    def __init__(
        self, key: bytes, now_ns: Callable[[], int], *, link_id: int = 0, store: Path | None = None
    ) -> None:
        if len(key) != 32:
            raise ConfigError(f"MAVLink signing key: expected 32 bytes, got {len(key)}")
        self._key = key
        self._now_ns = now_ns
        self._link_id = link_id
        self._store = store
        self._streams: dict[tuple[int, int, int], int] = {}
        """(system, component, link) to the time of its last genuine frame."""
        self._time = max(self._clock(), _stored(store))
        self._saved = 0
        self.refused = 0
        """Frames that were unsigned, forged, altered or replayed."""

    def _clock(self) -> int:
        return max(0, (self._now_ns() - EPOCH_NS) // UNIT_NS)

    def sign(self, frame: bytes, crc_extra: int) -> bytes:
        """A signed copy of an unsigned MAVLink 2 frame; the mark changes its checksum."""
        self._time = max(self._time + 1, self._clock())
        if self._store is not None and self._time - self._saved > SAVE_EVERY:
            self._save()
        head = bytes([frame[0], frame[1], frame[2] | SIGNED]) + frame[3:-2]
        signed = head + checksum(head, crc_extra) + bytes([self._link_id]) + self._time.to_bytes(6, "little")
        return signed + self._signature(signed)

    def _signature(self, frame: bytes) -> bytes:
        return hashlib.sha256(self._key + frame).digest()[:6]

    def accepts(self, frame: bytes) -> bool:
        """Whether a whole MAVLink 2 frame is genuine and new. Only then does its stream's time move."""
        good = self._judge(frame)
        self.refused += not good
        return good

    def _judge(self, frame: bytes) -> bool:
        if not frame[2] & SIGNED:
            return int.from_bytes(frame[7:10], "little") == RADIO_STATUS
        if not hmac.compare_digest(self._signature(frame[:-6]), frame[-6:]):
            return False
        stream = (frame[5], frame[6], frame[-SIGNATURE_SIZE])
        time = int.from_bytes(frame[-12:-6], "little")
        last = self._streams.get(stream)
        if last is None:
            if time < self._time - NEW_STREAM_BEHIND or len(self._streams) >= MAX_STREAMS:
                return False
        elif time <= last:
            return False
        self._streams[stream] = time
        self._time = max(self._time, time)
        return True

    def _save(self) -> None:
        self._saved = self._time
        if self._store is not None:
            write_whole(self._store, f"{self._time}\n")

    def close(self) -> None:
        """Keep the time for the next start: a vehicle refuses a sender that goes back."""
        if self._store is not None:
            self._save()


def _stored(store: Path | None) -> int:
    if store is None:
        return 0
    try:
        # One save interval on: the last frames before a crash came after the last save.
        return int(store.read_text()) + SAVE_EVERY
    except (OSError, ValueError):
        return 0


def read_key(path: Path) -> bytes:
    """A key file: 32 bytes raw, 64 hexadecimal digits, or a passphrase (its SHA-256, as MAVProxy does it).

    Raises `ConfigError` if others may read it.
    """
    try:
        content = path.read_bytes()
        mode = stat.S_IMODE(path.stat().st_mode)
    except OSError as error:
        raise ConfigError(f"signing key {path}: {error.strerror}") from error
    if os.name == "posix" and mode & 0o077:
        raise ConfigError(f"signing key {path}: others may read it (mode {mode:03o}); chmod 600 {path}")
    if len(content) == 32:
        return content
    text = content.strip()
    if len(text) == 64:
        try:
            return bytes.fromhex(text.decode("ascii"))
        except ValueError:
            pass
    if not text:
        raise ConfigError(f"signing key {path}: is empty")
    return hashlib.sha256(text).digest()
