"""Messages that only members of the mission can write, each heard once. Pure.

A message is its kind, its sender, a stamp that only grows, what it says, and a keyed hash of all that (BLAKE2b, RFC
7693, cut to 64 bits; MAVLink's signing cuts SHA-256 to 48). The key of a conversation is made of the mission's key and
of what all members must have in common, so agents of another mission file or another version do not hear each other.
"""

import hashlib
import hmac
import math
from collections import Counter, deque
from dataclasses import dataclass, field

from fieldkit.errors import ConfigError

KEY_BYTES = 32
MAC_BYTES = 8
STAMP_BYTES = 6
STAMP_NS = 10_000
STAMP_EPOCH_NS = 1_420_070_400_000_000_000
"""Stamps count steps of 10 us since 2015, as those of MAVLink's signing: https://mavlink.io/en/guide/message_signing.html"""
OVERHEAD_BYTES = 2 + STAMP_BYTES + MAC_BYTES
STALE_S = 120.0
"""A message so much older than this computer's time is not heard: whoever has kept it may be replaying it."""
REMEMBERED = 512
"""Stamps of each sender that are remembered; what is older than all of these was heard, or is too late."""


def parse_key(text: str, where: str) -> bytes:
    """The mission's key from a file of 64 hexadecimal digits. Raises `ConfigError`."""
    try:
        key = bytes.fromhex(text.strip())
    except ValueError:
        key = b""
    if len(key) != KEY_BYTES:
        raise ConfigError(
            f"{where}: expected {2 * KEY_BYTES} hexadecimal digits, got something else; copy it from another robot"
        )
    return key


def session_key(key: bytes, common: str) -> bytes:
    """The key of those that have `common` in common."""
    return hashlib.blake2b(common.encode(), key=key, digest_size=KEY_BYTES).digest()


def signed(key: bytes, data: bytes) -> bytes:
    """The data with its keyed hash behind it."""
    return data + hashlib.blake2b(data, key=key, digest_size=MAC_BYTES).digest()


def unsigned(key: bytes, data: bytes) -> bytes | None:
    """The data without its keyed hash; None where that is not right."""
    said = data[:-MAC_BYTES]
    return said if len(data) > MAC_BYTES and hmac.compare_digest(signed(key, said), data) else None


@dataclass(frozen=True, slots=True)
class Opened:
    """A message that a member has sent."""

    kind: int
    sender: int
    sent_ns: int
    """By the sender's clock."""
    body: bytes


@dataclass
class Seal:
    """One member's hand and ear. `me` is its number among the members."""

    key: bytes
    me: int
    dropped: Counter[str] = field(default_factory=Counter)
    """Messages that were not heard, by why: "forged", "repeated", "stale", "own"."""
    stale_s: dict[int, float] = field(default_factory=dict)
    """By how many seconds the last message of a sender that was dropped as stale came from ahead of our time."""
    _stamp: int = 0
    _heard: dict[int, "_Heard"] = field(default_factory=dict)

    def write(self, kind: int, body: bytes, now_ns: int) -> bytes:
        """A message as it goes out."""
        self._stamp = max(self._stamp + 1, (now_ns - STAMP_EPOCH_NS) // STAMP_NS, 0)
        return signed(self.key, bytes((kind, self.me)) + self._stamp.to_bytes(STAMP_BYTES, "big") + body)

    def read(self, data: bytes, now_ns: int) -> Opened | None:
        """A message that came in; None where it is to be dropped, which is counted."""
        said = unsigned(self.key, data)
        if said is None or len(data) < OVERHEAD_BYTES:
            return self._drop("forged")
        kind, sender = said[0], said[1]
        if sender == self.me:
            return self._drop("own")
        stamp = int.from_bytes(said[2 : 2 + STAMP_BYTES], "big")
        sent_ns = stamp * STAMP_NS + STAMP_EPOCH_NS
        if abs(now_ns - sent_ns) * 1e-9 > STALE_S:
            self.stale_s[sender] = (sent_ns - now_ns) * 1e-9
            return self._drop("stale")
        if not self._heard.setdefault(sender, _Heard()).is_new(stamp):
            return self._drop("repeated")
        return Opened(kind, sender, sent_ns, said[2 + STAMP_BYTES :])

    def _drop(self, why: str) -> Opened | None:
        self.dropped[why] += 1
        return None


@dataclass
class _Heard:
    """The stamps of one sender, whatever order they come in."""

    floor: float = -math.inf
    stamps: set[int] = field(default_factory=set)
    order: deque[int] = field(default_factory=deque)

    def is_new(self, stamp: int) -> bool:
        if stamp <= self.floor or stamp in self.stamps:
            return False
        self.stamps.add(stamp)
        self.order.append(stamp)
        if len(self.order) > REMEMBERED:
            oldest = self.order.popleft()
            self.stamps.discard(oldest)
            self.floor = max(self.floor, oldest)
        return True
