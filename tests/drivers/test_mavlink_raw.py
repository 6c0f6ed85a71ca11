"""Raw bytes of vehicle links: all of them, and never a signing key."""

import secrets
from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect

from drivers.mavlink.tapped import TappedTransport


class Loose:
    """A transport without a wire."""

    dropped, default_peer = 3, "somebody"

    def __init__(self) -> None:
        self.sent: list[bytes] = []

    async def open(self, on_data):  # type: ignore[no-untyped-def]
        self.give = on_data

    def send(self, data: bytes, peer: object) -> None:
        self.sent.append(data)

    async def close(self) -> None:
        self.give = None


def frames() -> tuple[bytes, bytes, bytes]:
    """A heartbeat, a SETUP_SIGNING with a key, and that key, by pymavlink."""
    link = dialect.MAVLink(None, 255, 190)
    key = secrets.token_bytes(32)
    beat = dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3).pack(link)
    return beat, dialect.MAVLink_setup_signing_message(1, 1, list(key), 12345).pack(link), key


async def test_both_directions_are_told_and_handed_on() -> None:
    kept: list[tuple[str, bytes]] = []
    loose, heard = Loose(), []
    tapped = TappedTransport(loose, "udpin:1", lambda name, data: kept.append((name, data)))
    await tapped.open(lambda data, peer: heard.append((data, peer)))
    beat, _, _ = frames()
    loose.give(beat, "v")
    tapped.send(b"\xfd out", "v")
    assert kept == [("udpin:1/in", beat), ("udpin:1/out", b"\xfd out")]
    assert heard == [(beat, "v")] and loose.sent == [b"\xfd out"]
    assert (tapped.dropped, tapped.default_peer) == (3, "somebody")
    await tapped.close()


@given(cuts=st.lists(st.integers(1, 200), max_size=8), before=st.integers(0, 3))
async def test_a_signing_key_is_never_kept_however_the_stream_is_cut(cuts: list[int], before: int) -> None:
    beat, setup, key = frames()
    stream = beat * before + setup + beat * 20
    kept: list[bytes] = []
    loose, heard = Loose(), []
    tapped = TappedTransport(loose, "tcp:1", lambda name, data: kept.append(data))
    await tapped.open(lambda data, peer: heard.append(data))
    edges = sorted({0, *(cut % len(stream) for cut in cuts), len(stream)})
    for begin, end in pairwise(edges):
        loose.give(stream[begin:end], "v")
    assert b"".join(heard) == stream, "the driver gets everything"
    left = b"".join(kept)
    assert not any(key[k : k + 6] in left for k in range(26))
    for _ in range(40):
        loose.give(beat, "v")
    assert kept and kept[-1] == beat, "and what comes later is kept again"
