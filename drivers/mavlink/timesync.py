"""A vehicle's clock against ours by TIMESYNC, with the only honest bound: half of the shortest round trip.

Link asymmetry shifts the estimate by half of what the two ways differ, and no averaging shows it; RTT/2 holds
whatever the asymmetry. https://mavlink.io/en/services/timesync.html
"""

from collections.abc import Callable
from dataclasses import dataclass

from drivers.mavlink.codec import Message, mavlink
from drivers.mavlink.plans import Inbox
from fieldkit.clock import Clock

EXCHANGES = 10
WAIT_S = 1.0
GAP_S = 0.1


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """`offset_ns` is the vehicle's boot clock minus mission time, right to within `bound_ns`."""

    offset_ns: int
    bound_ns: int
    exchanges: int
    """How many were answered."""


def best(exchanges: list[tuple[int, int, int]]) -> ClockOffset | None:
    """From (sent, vehicle's time, received) in ns: the exchange with the shortest round trip; None for none."""
    if not exchanges:
        return None
    sent, theirs, received = min(exchanges, key=lambda exchange: exchange[2] - exchange[0])
    return ClockOffset(theirs - (sent + received) // 2, -(-(received - sent) // 2), len(exchanges))


async def exchange(
    send: Callable[[Message], None], inbox: Inbox, clock: Clock, own_mark: int, count: int = EXCHANGES
) -> ClockOffset | None:
    """Ask `count` times. `own_mark` (a system id) makes our time stamps differ from other stations'."""
    answered: list[tuple[int, int, int]] = []
    for _ in range(count):
        sent = clock.now_ns() // 256 * 256 + own_mark  # answers carry it back: it is how we know them
        send(mavlink.MAVLink_timesync_message(0, sent))
        deadline_s = clock.elapsed_s() + WAIT_S
        while (left_s := deadline_s - clock.elapsed_s()) > 0:
            message = await inbox.next(left_s)
            if message is not None and message.ts1 == sent and message.tc1 != 0:
                answered.append((sent, message.tc1, clock.now_ns()))
                break
        await clock.sleep(GAP_S)
    return best(answered)
