"""ROS 2 recordings (MCAP), through mcap-ros2-support: positions by well-known messages, readings by a map of topics.

Positions are `sensor_msgs/NavSatFix`, or else `nav_msgs/Odometry` or `geometry_msgs/PoseStamped`, whose x is east and y
north (REP 103). Where several topics have positions, a robot is named by the first part of its topic: /r1/fix is r1's.
"""

import math
import tomllib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from drivers.lines.mapping import LineMap, NoReadingError
from drivers.positions.tracks import GPS_SIGMA_M, ONLY, Spot, Track, add, renamed
from fieldkit.errors import ConfigError, DataError
from fieldkit.files import is_stream
from fieldkit.messages import RssReading

LOCAL_SIGMA_M = 0.05
"""Standard deviation of a local position whose covariance is not given."""
LONGEST_ARRAY = 1000
"""A longer array is a picture or a cloud of points, and no part of a reading."""
_READING = {each.name for each in fields(LineMap)} - {"format", "pattern", "columns", "about", "example"}


@dataclass(frozen=True, slots=True)
class BagMessage:
    """One message of a bag."""

    topic: str
    kind: str
    """As in sensor_msgs/NavSatFix."""
    t_ns: int
    """Its header's stamp; where it has none, when it was written."""
    message: Any


def is_bag(path: Path) -> bool:
    """Whether this is a ROS 2 recording: a file of that profile, or a folder with some."""
    if path.is_dir():
        return any(map(is_bag, _files(path)))
    from mcap.exceptions import McapError
    from mcap.reader import NonSeekingReader

    try:
        with path.open("rb") as stream:
            return bool(NonSeekingReader(stream).get_header().profile == "ros2")
    except (OSError, McapError, ValueError):
        return False


def _files(path: Path) -> list[Path]:
    return sorted(path.glob("*.mcap")) if path.is_dir() else [path]


def _messages(path: Path, wanted: Callable[[str, str], bool], notes: list[str]) -> Iterator[BagMessage]:
    """Messages whose (topic, kind) is wanted, as written. A bag that was cut off gives what came before."""
    import struct

    from mcap.exceptions import McapError
    from mcap.reader import NonSeekingReader
    from mcap_ros2.decoder import DecoderFactory

    for file in _files(path):
        decoders = DecoderFactory()
        with file.open("rb") as stream:
            try:
                # Schemas and channels stand before their messages: this needs no index, which a cut bag does not have.
                for schema, channel, record in NonSeekingReader(stream).iter_messages(log_time_order=False):
                    kind = "" if schema is None else schema.name.replace("/msg/", "/")
                    if not wanted(channel.topic, kind):
                        continue
                    decode = decoders.decoder_for(channel.message_encoding, schema)
                    if decode is None:
                        raise DataError(
                            f"{file}: {channel.topic}: its schema is no ROS 2 message definition, which alone is read"
                        )
                    message = decode(record.data)
                    yield BagMessage(channel.topic, kind, _stamp_ns(message) or record.log_time, message)
            except (McapError, EOFError, ValueError, struct.error, UnicodeDecodeError) as error:
                notes.append(f"{file.name}: not readable to its end ({error or type(error).__name__})")


def _stamp_ns(message: Any) -> int:
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    return 0 if stamp is None else int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


# -- positions -------------------------------------------------------------------------------------------------


def read_bag(path: Path) -> Track:
    """The positions of a bag. Raises `DataError` where it has none."""
    makers: dict[str, Callable[[BagMessage], Spot | None]] = {
        "sensor_msgs/NavSatFix": _of_fix,
        "nav_msgs/Odometry": _of_odometry,
        "geometry_msgs/PoseStamped": _of_pose,
    }
    notes: list[str] = []
    by_topic: dict[tuple[str, str], list[Spot | None]] = {}
    for item in _messages(path, lambda _, kind: kind in makers, notes):
        spots = by_topic.setdefault((item.kind, item.topic), [])
        spots.append(makers[item.kind](item))
    kinds = {kind for kind, _ in by_topic}
    chosen = next((kind for kind in makers if kind in kinds), None)
    if chosen is None:
        raise DataError(f"{path}: no topic has positions; read are {', '.join(makers)}{_also(notes)}")
    topics = [topic for kind, topic in by_topic if kind == chosen]
    left_out = [topic for kind, topic in by_topic if kind != chosen]
    if left_out:
        notes.append(f"positions are those of {', '.join(topics)}; {', '.join(left_out)} are left out")
    track = Track(path, geodetic=chosen == "sensor_msgs/NavSatFix", notes=notes)
    track.heights = not track.geodetic
    for topic in topics:
        name = ONLY if len(topics) == 1 else topic.strip("/").split("/")[0]
        for spot in by_topic[chosen, topic]:
            if spot is None:
                track.skipped += 1
            else:
                add(track, renamed(spot, name))
    return track


def _also(notes: Sequence[str]) -> str:
    return "".join(f"; {note}" for note in notes)


def _of_fix(item: BagMessage) -> Spot | None:
    """None without a fix. The height, above the ellipsoid, is not the field's: it is left out."""
    message = item.message
    if message.status.status < 0:
        return None
    sigma_m = _sigma_m(message.position_covariance, 0, 4) if message.position_covariance_type else None
    return Spot(
        item.t_ns,
        ONLY,
        message.latitude,
        message.longitude,
        sigma_m=GPS_SIGMA_M if sigma_m is None else sigma_m,
    )


def _of_odometry(item: BagMessage) -> Spot:
    sigma_m = _sigma_m(item.message.pose.covariance, 0, 7)
    return _local(item, item.message.pose.pose, LOCAL_SIGMA_M if sigma_m is None else sigma_m)


def _of_pose(item: BagMessage) -> Spot:
    return _local(item, item.message.pose, LOCAL_SIGMA_M)


def _local(item: BagMessage, pose: Any, sigma_m: float) -> Spot:
    q, place = pose.orientation, pose.position
    yaw = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y**2 + q.z**2))
    heading_deg = (90.0 - math.degrees(yaw)) % 360.0
    return Spot(item.t_ns, ONLY, place.x, place.y, place.z, heading_deg, sigma_m)


def _sigma_m(covariance: Sequence[float], first: int, second: int) -> float | None:
    """Of each horizontal coordinate; None where the covariance says nothing."""
    variance = (covariance[first] + covariance[second]) / 2.0
    return math.sqrt(variance) if math.isfinite(variance) and variance > 0.0 else None


# -- readings --------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class TopicMap:
    """What messages of one topic say: keys are those of a line's map, values paths such as `payload.rssi`."""

    line: LineMap
    robot: str | None = None


def read_topic_maps(path: Path) -> dict[str, TopicMap]:
    """A TOML file with a table for each topic: `["/r1/packets"]`, `rss = "rssi"`. Raises `ConfigError`."""
    if is_stream(path):
        raise ConfigError(f"{path}: expected a map of topics, got a pipe or device")
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read as a map of topics: {error}") from error
    maps = {}
    for topic, table in tables.items():
        where = f"{path}: {topic}"
        if not isinstance(table, dict) or "rss" not in table:
            raise ConfigError(f'{where}: expected a table with the path of the strength, as in rss = "rssi"')
        if unknown := table.keys() - _READING - {"robot"}:
            raise ConfigError(f"{where}: no such key: {', '.join(sorted(unknown))}")
        own: dict[str, Any] = {key: str(value) for key, value in table.items() if key != "robot"}
        line = LineMap("json", **own)
        line.check(where)
        maps[topic] = TopicMap(line, table.get("robot"))
    return maps


def bag_readings(path: Path, robot: str, maps: dict[str, TopicMap], notes: list[str]) -> list[RssReading]:
    """What the mapped topics say was heard. Raises `DataError` that names the topics there are where none is mapped."""
    if not maps:
        raise DataError(
            f"{path}: say which of its topics have readings: --topics FILE. It has {_topics(path)}"
        )
    heard: list[RssReading] = []
    bad: dict[str, tuple[int, str]] = {}
    for item in _messages(path, lambda topic, _: topic in maps, notes):
        made = maps[item.topic]
        try:
            said = made.line.read_values(as_dict(item.message))
        except NoReadingError as error:
            count, first = bad.get(item.topic, (0, str(error)))
            bad[item.topic] = count + 1, first
            continue
        if said is not None:
            # The header's stamp is mission time; a radio's own clock in the message may be years off.
            heard.append(
                RssReading(
                    item.t_ns, made.robot or robot, said.rss_dbm, "lines", said.channel, said.frame_id()
                )
            )
    notes += [f"{topic}: {n} messages are no readings; the first {why}" for topic, (n, why) in bad.items()]
    if not heard:
        raise DataError(f"{path}: no reading on {', '.join(maps)}; it has {_topics(path)}{_also(notes)}")
    return heard


def _topics(path: Path) -> str:
    found: dict[str, str] = {}

    def note(topic: str, kind: str) -> bool:
        found[topic] = kind
        return False

    for _ in _messages(path, note, []):
        pass
    return ", ".join(f"{topic} ({kind})" for topic, kind in sorted(found.items())) or "no messages"


def as_dict(message: Any) -> Any:
    """A decoded message as what JSON would have; long arrays are left out."""
    if isinstance(message, list | tuple):
        return [as_dict(each) for each in message[:LONGEST_ARRAY]]
    if not isinstance(message, SimpleNamespace):
        return message
    # Decoded messages keep their fields in slots of a class made for their kind.
    return {name: as_dict(getattr(message, name)) for name in type(message).__slots__}  # type: ignore[attr-defined]
