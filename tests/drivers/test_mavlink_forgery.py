"""Ten thousand frames that are not what they say, mixed into genuine streams: none gets in, no genuine one is lost."""

import random

import pytest

from drivers.mavlink.codec import Packer, Parser, mavlink
from drivers.mavlink.signing import EPOCH_NS, MAX_STREAMS, SIGNATURE_SIZE, UNIT_NS, Signer
from drivers.mavlink.wire import checksum

KEY = bytes(range(32))
NOW_NS = 1_800_000_000 * 10**9
FRAMES = 10_000
VEHICLES = 8


class Clock:
    """Time that the test moves."""

    def __init__(self) -> None:
        self.now_ns = NOW_NS

    def __call__(self) -> int:
        return self.now_ns


def crc_right(frame: bytes) -> bytes:
    """The frame with its checksum made right again: only the signature can tell."""
    known = mavlink.mavlink_map[int.from_bytes(frame[7:10], "little")]
    end = 10 + frame[1]
    return frame[:end] + checksum(frame[:end], known.crc_extra) + frame[end + 2 :]


class Attacker:
    """Has heard every genuine frame, knows the protocol, has no key."""

    def __init__(self, rng: random.Random) -> None:
        self.rng = rng
        self.heard: list[bytes] = []
        self.tricks = (
            self.unsigned, self.wrong_key, self.far_future, self.altered_payload, self.altered_header,
            self.altered_time, self.altered_signature, self.replayed, self.moved_to_another_link, self.cut,
        )  # fmt: skip

    def frame(self) -> bytes:
        return self.rng.choice(self.rng.choice(self.tricks)())

    def victim(self) -> bytes:
        return self.rng.choice(self.heard[-500:])

    def made_up(self, signer: Signer | None) -> bytes:
        order = mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1, 21196, 0, 0, 0, 0, 0)
        return Packer(self.rng.randint(1, 255), self.rng.choice((1, 190)), signer).pack(order)

    def unsigned(self) -> list[bytes]:
        return [self.made_up(None)]

    def wrong_key(self) -> list[bytes]:
        return [self.made_up(Signer(self.rng.randbytes(32), Clock(), link_id=self.rng.randrange(256)))]

    def far_future(self) -> list[bytes]:
        """The one that locks a genuine sender out of pymavlink for ever."""
        frame = bytearray(self.victim())
        ahead = (NOW_NS - EPOCH_NS) // UNIT_NS + self.rng.randrange(10**12)
        frame[-12:-6] = ahead.to_bytes(6, "little")
        return [bytes(frame)]

    def altered_payload(self) -> list[bytes]:
        frame = bytearray(self.victim())
        frame[10 + self.rng.randrange(frame[1])] ^= 1 << self.rng.randrange(8)
        return [crc_right(bytes(frame))]

    def altered_header(self) -> list[bytes]:
        """Another sender, another number."""
        frame = bytearray(self.victim())
        frame[self.rng.choice((4, 5, 6))] ^= 1 << self.rng.randrange(8)
        return [crc_right(bytes(frame))]

    def altered_time(self) -> list[bytes]:
        frame = bytearray(self.victim())
        frame[-7 - self.rng.randrange(6)] ^= 1 << self.rng.randrange(8)
        return [bytes(frame)]

    def altered_signature(self) -> list[bytes]:
        frame = bytearray(self.victim())
        frame[-1 - self.rng.randrange(6)] ^= 1 << self.rng.randrange(8)
        return [bytes(frame)]

    def replayed(self) -> list[bytes]:
        return [self.victim()]

    def moved_to_another_link(self) -> list[bytes]:
        """A genuine frame under a new link id: a stream not heard before."""
        frame = bytearray(self.victim())
        frame[-SIGNATURE_SIZE] ^= 1 + self.rng.randrange(255)
        return [bytes(frame)]

    def cut(self) -> list[bytes]:
        """Its signature taken off, and the mark of it as well."""
        frame = bytearray(self.victim()[:-SIGNATURE_SIZE])
        frame[2] &= 0xFE
        return [crc_right(bytes(frame))]


@pytest.mark.parametrize("seed", range(3))
def test_none_of_ten_thousand_gets_in_and_no_genuine_frame_is_lost(seed: int) -> None:
    rng = random.Random(seed)
    now = Clock()
    senders = [Packer(number, 1, Signer(KEY, now, link_id=number)) for number in range(1, VEHICLES + 1)]
    ours = Signer(KEY, now, link_id=99)
    parser, attacker = Parser(ours), Attacker(rng)
    sent = got = false = 0
    for number in range(FRAMES):
        now.now_ns += 1_000_000
        if number % 2 == 0 or not attacker.heard:
            mode = rng.randrange(1, 2**31)
            genuine = rng.choice(senders).pack(mavlink.MAVLink_heartbeat_message(10, 3, 0, mode, 4, 3))
            attacker.heard.append(genuine)
            sent += 1
            heard = parser.parse(genuine)
            got += [message.custom_mode for message in heard] == [mode]
        for _ in range(2 if number % 2 else 1):
            false += len(parser.parse(attacker.frame()))
    assert false == 0
    assert got == sent == FRAMES // 2
    assert ours.refused > FRAMES
    assert len(ours._streams) <= min(VEHICLES, MAX_STREAMS)


def test_the_attacker_is_dangerous_to_whoever_does_not_check() -> None:
    """Against a parser without a key nearly all of its frames get in: the test above could fail."""
    rng = random.Random(1)
    attacker = Attacker(rng)
    sender = Packer(1, 1, Signer(KEY, Clock(), link_id=1))
    attacker.heard = [sender.pack(mavlink.MAVLink_heartbeat_message(10, 3, 0, 15, 4, 3)) for _ in range(50)]
    careless = Parser()
    accepted = sum(len(careless.parse(attacker.frame())) for _ in range(1000))
    assert accepted > 900
