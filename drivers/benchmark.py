"""How fast the XBee driver takes readings, against the stock library: `fieldkit bench xbee`.

An emulated module in a process of its own, on a pty or TCP. By hand, at another rate, JSON on standard output:

    python -m drivers.benchmark --rate-hz 4000 --seconds 60
"""

import asyncio
import json
import logging
import multiprocessing
import statistics
import time
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from typing import Annotated, Any

import typer

from drivers.emulators.wires import PluggedModule, make_wire
from drivers.emulators.xbee import Module
from drivers.xbee.receiver import open_receiver
from fieldkit.clock import RealClock, wall_s
from fieldkit.geo import FieldFrame
from fieldkit.messages import RssReading
from fieldkit.ports import DriverContext

OFFERED_HZ, FOR_S, SENDERS = 2000.0, 10.0, 1000
SENDER = 0x0013A20041000000
SETTLE_S = 2.0
"""Wall time a reader is given for what is still in the pipe."""


def xbee(rate_hz: float = OFFERED_HZ, duration_s: float = FOR_S, senders: int = SENDERS) -> dict[str, Any]:
    """The driver and the stock library on the same stream, one after the other."""
    ours = xbee_throughput(rate_hz, duration_s, senders)
    stock = stock_throughput(rate_hz, duration_s, senders)
    return {
        "offered_per_s": rate_hz,
        "duration_s": duration_s,
        "senders": senders,
        "fieldkit": ours,
        "stock_digi_xbee": stock,
        "times_stock": round(ours["readings_per_s"] / max(stock["readings_per_s"], 1e-9), 1),
    }


def xbee_throughput(
    rate_hz: float = OFFERED_HZ, duration_s: float = FOR_S, senders: int = SENDERS
) -> dict[str, Any]:
    """Readings taken at a steady rate from `senders` distinct senders.

    Gives sent, received, lost, in_order, readings_per_s, and stamp_delay_ms: reception stamp minus the moment
    the frame was put on the wire, both on this machine's clock (p50, p99, max, share within 5 ms).
    """
    with _emulated(rate_hz, duration_s, senders) as connection:
        return asyncio.run(_measure(connection, connection.recv()))


def stock_throughput(rate_hz: float, duration_s: float, senders: int) -> dict[str, Any]:
    """The same stream, taken by digi-xbee as it comes: sent, received, lost, in_order, readings_per_s."""
    from digi.xbee.devices import Raw802Device

    logging.getLogger("digi.xbee.reader").setLevel(logging.CRITICAL)  # it logs each frame it loses
    received: list[int] = []
    with _emulated(rate_hz, duration_s, senders) as connection:
        device = Raw802Device(connection.recv(), 115200)
        device.open()
        try:
            device.add_packet_received_callback(
                lambda packet: received.append(int.from_bytes(packet.rf_data[:4], "big"))
            )
            connection.send("go")
            began_s = wall_s()
            sent_ns, refused = connection.recv()
            took_s = wall_s() - began_s
            time.sleep(SETTLE_S)
        finally:
            device.close()
    return {
        "sent": len(sent_ns),
        "received": len(received),
        "lost": len(sent_ns) - len(received),
        "refused_by_pty": refused,
        "in_order": received == sorted(received),
        "readings_per_s": round(len(received) / (took_s + SETTLE_S), 1),
    }


@contextmanager
def _emulated(rate_hz: float, duration_s: float, senders: int) -> Iterator[Connection]:
    """A module that sends once ordered to go. First it says its port, at the end what it sent."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    child = context.Process(target=_emulate, args=(theirs, rate_hz, duration_s, senders), daemon=True)
    child.start()
    try:
        yield ours
    finally:
        ours.close()
        child.join(5.0)
        if child.is_alive():
            child.terminate()


async def _measure(connection: Connection, port: str) -> dict[str, Any]:
    receiver = open_receiver("bench", {"port": port}, DriverContext(RealClock(), FieldFrame(0.0, 0.0)))
    readings: list[RssReading] = []
    async with receiver:

        async def collect() -> None:
            async for item in receiver.readings():
                if isinstance(item, RssReading):
                    readings.append(item)

        task = asyncio.create_task(collect())
        connection.send("go")
        began_s = wall_s()
        sent_ns, refused = await asyncio.to_thread(connection.recv)
        took_s = wall_s() - began_s
        for _ in range(40):
            if len(readings) >= len(sent_ns):
                break
            await asyncio.sleep(0.05)
    await task
    return _figures(readings, sent_ns, refused, took_s)


def _figures(readings: list[RssReading], sent_ns: list[int], refused: int, took_s: float) -> dict[str, Any]:
    stamps = [reading.t_ns for reading in readings]
    delays_ms = [0.0]
    if len(stamps) == len(sent_ns) > 100:
        offset_ns = time.time_ns() - time.monotonic_ns()
        delays_ms = [(t_ns - s_ns - offset_ns) * 1e-6 for t_ns, s_ns in zip(stamps, sent_ns, strict=True)]
    cuts = statistics.quantiles(delays_ms, n=100) if len(delays_ms) > 1 else [0.0] * 99
    return {
        "sent": len(sent_ns),
        "received": len(readings),
        "lost": len(sent_ns) - len(readings),
        "refused_by_pty": refused,
        "in_order": stamps == sorted(stamps),
        "readings_per_s": round(len(readings) / took_s, 1),
        "stamp_delay_ms": {
            "p50": round(cuts[49], 3),
            "p99": round(cuts[98], 3),
            "max": round(max(delays_ms), 3),
            "share_within_5": round(sum(abs(delay) <= 5.0 for delay in delays_ms) / len(delays_ms), 5),
        },
    }


def _emulate(connection: Connection, rate_hz: float, duration_s: float, senders: int) -> None:
    asyncio.run(_send(connection, rate_hz, duration_s, senders))


async def _send(connection: Connection, rate_hz: float, duration_s: float, senders: int) -> None:
    radio = PluggedModule(Module(), make_wire())
    await radio.plug()
    connection.send(radio.wire.port)
    await asyncio.to_thread(connection.recv)
    sent_ns: list[int] = []
    began_s = time.monotonic()
    total = round(rate_hz * duration_s)
    while len(sent_ns) < total:
        due = min(total, int((time.monotonic() - began_s) * rate_hz) + 1)
        for number in range(len(sent_ns), due):
            sent_ns.append(time.monotonic_ns())
            payload = number.to_bytes(4, "big") + b"beacon"
            radio.hear(-45.0 - number % 50, SENDER + number % senders, payload)
        await asyncio.sleep(0.0005)
    connection.send((sent_ns, radio.lost_writes))
    await asyncio.sleep(3.0)


def main(
    rate_hz: Annotated[float, typer.Option(min=1.0, help="Frames per second offered.")] = OFFERED_HZ,
    seconds: Annotated[float, typer.Option(min=0.1, help="For how long.")] = FOR_S,
    senders: Annotated[int, typer.Option(min=1, help="Distinct 64-bit senders.")] = SENDERS,
    stock: Annotated[bool, typer.Option(help="Measure stock digi-xbee too.")] = True,
) -> None:
    """Measure the XBee driver. Example: python -m drivers.benchmark --rate-hz 4000 --seconds 60"""
    result = xbee(rate_hz, seconds, senders) if stock else xbee_throughput(rate_hz, seconds, senders)
    typer.echo(json.dumps(result, indent=2))


if __name__ == "__main__":
    typer.run(main)
