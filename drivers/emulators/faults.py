"""What can happen to bytes on a wire, as functions from what the device wrote to what arrives.

Each is deterministic in the generator it is given. `PluggedModule.rewrite` takes one for the next write,
`PluggedModule.always` one for all; pausing, rebooting and unplugging are methods of `PluggedModule`.
"""

import random
from collections.abc import Callable

Rewrite = Callable[[bytes], bytes]

GARBAGE_MAX = 40


def drop(data: bytes) -> bytes:
    """Nothing arrives."""
    return b""


def duplicate(data: bytes) -> bytes:
    """It arrives twice, as a repeated broadcast does."""
    return data + data


def lose_byte(rng: random.Random) -> Rewrite:
    """One byte is missing."""

    def rewrite(data: bytes) -> bytes:
        at = rng.randrange(len(data))
        return data[:at] + data[at + 1 :]

    return rewrite


def flip_bit(rng: random.Random) -> Rewrite:
    """One bit is wrong."""

    def rewrite(data: bytes) -> bytes:
        at = rng.randrange(len(data))
        return data[:at] + bytes([data[at] ^ 1 << rng.randrange(8)]) + data[at + 1 :]

    return rewrite


def truncate(rng: random.Random) -> Rewrite:
    """The end is missing."""
    return lambda data: data[: rng.randrange(len(data))]


def insert_garbage(rng: random.Random) -> Rewrite:
    """Bytes that belong to nothing come first."""
    return lambda data: rng.randbytes(rng.randint(1, GARBAGE_MAX)) + data


def wrong_baud(rng: random.Random) -> Rewrite:
    """Every byte becomes another, and some none: what a UART reads at the wrong speed."""
    return lambda data: bytes(rng.randrange(256) for _ in data if rng.random() < 0.7)


FAULTS: dict[str, Callable[[random.Random], Rewrite]] = {
    "drop": lambda rng: drop,
    "lose byte": lose_byte,
    "flip bit": flip_bit,
    "truncate": truncate,
    "garbage": insert_garbage,
    "duplicate": lambda rng: duplicate,
}
"""Faults that cost at most the write they hit."""


class SkewedClock:
    """A device's own microseconds: `parts_per_million` too fast, and jumping on command."""

    def __init__(self, now_us: Callable[[], int], parts_per_million: float = 0.0) -> None:
        self._now_us = now_us
        self._rate = 1.0 + parts_per_million * 1e-6
        self._began_us = now_us()
        self.jump_us = 0
        """Added to the time from now on; negative jumps back."""

    def __call__(self) -> int:
        return self._began_us + self.jump_us + round((self._now_us() - self._began_us) * self._rate)
