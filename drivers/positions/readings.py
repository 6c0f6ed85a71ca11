"""Logs of readings of any kind: CSV, a fieldkit recording, an 802.15.4 capture, a ROS 2 recording."""

from pathlib import Path

from drivers.positions.table import number, read_table, timed
from drivers.positions.tracks import ONLY
from fieldkit.errors import DataError
from fieldkit.files import is_stream
from fieldkit.messages import ReceiverState, RssReading

Heard = RssReading | ReceiverState


def read_readings(
    path: Path,
    robot: str = ONLY,
    *,
    relative: bool = False,
    notes: list[str] | None = None,
    topics: Path | None = None,
) -> list[Heard]:
    """Readings and receivers' states, in order of time. `robot` names the receiver of a log without names.

    `relative`: levels are dB against whatever, so any finite number is one. What was left out is added to `notes`.

    `topics` is a file that says which topics of a ROS 2 recording have readings, and where in their messages.

    Raises `DataError` where it is missing, of an unknown kind, or nothing was heard.
    """
    kinds = {".mcap": _recording, ".pcap": _capture, ".pcapng": _capture}
    if is_stream(path):
        raise DataError(
            f"{path}: expected a file of readings, got a pipe or device; write it into a file first"
        )
    ending = path.suffix.lower()
    if path.is_dir() or ending == ".mcap":
        from drivers.positions.bags import bag_readings, is_bag, read_topic_maps

        if is_bag(path):
            maps = {} if topics is None else read_topic_maps(topics)
            return sorted(bag_readings(path, robot, maps, notes if notes is not None else []), key=_time)
    if ending != ".csv" and ending not in kinds:
        raise DataError(f"{path}: expected one of .csv, {', '.join(kinds)}, got '{path.suffix}'")
    if not path.is_file():
        raise DataError(f"{path}: no such file")
    if ending == ".csv":
        found = _csv(path, robot, relative, notes if notes is not None else [])
    else:
        found = kinds[ending](path, robot)
    heard = sorted(found, key=_time)
    if not any(isinstance(item, RssReading) for item in heard):
        raise DataError(f"{path}: holds no reading of received strength")
    return heard


def _time(item: Heard) -> int:
    return item.t_ns


def _csv(path: Path, robot: str, relative: bool, notes: list[str]) -> list[Heard]:
    """Rows whose strength is empty are packets that were not heard: silence says that already."""
    table = read_table(path)
    if "rss_dbm" not in table.names:
        raise DataError(f"{path}: no column rss_dbm")
    heard: list[Heard] = []
    for line, t_ns, row in timed(table):
        rss_dbm = number(row, "rss_dbm")
        if rss_dbm is None or not (relative or -150.0 <= rss_dbm < 0.0):
            if row["rss_dbm"]:
                table.bad(
                    line,
                    f"{row['rss_dbm']!r} is no received power in dBm (relative dB: say so with --relative)",
                )
            continue
        channel = number(row, "channel")
        heard.append(
            RssReading(
                t_ns,
                row.get("robot") or robot,
                rss_dbm,
                "sim",
                None if channel is None else int(channel),
                row.get("frame_id") or row.get("address") or None,
            )
        )
    if table.skipped > len(heard):
        raise DataError(f"{path}: {table.skipped} rows cannot be read; the first is {table.first_bad}")
    notes += table.notes()
    return heard


def _recording(path: Path, robot: str) -> list[Heard]:
    from fieldkit.recording.reader import open_recording

    return [
        event
        for _, _, event in open_recording(path).events()
        if isinstance(event, RssReading | ReceiverState)
    ]


def _capture(path: Path, robot: str) -> list[Heard]:
    import asyncio

    return asyncio.run(_from_capture(path, robot))


async def _from_capture(path: Path, robot: str) -> list[Heard]:
    from drivers.sniffers.pcap import open_capture
    from fieldkit.clock import RealClock
    from fieldkit.geo import FieldFrame
    from fieldkit.ports import DriverContext

    heard: list[Heard] = []
    around = DriverContext(RealClock(), FieldFrame(0.0, 0.0))
    async with open_capture(robot, {"port": str(path)}, around) as receiver:
        async for item in receiver.readings():
            if isinstance(item, RssReading):
                heard.append(item)
            elif not item.up:
                break
    return heard
