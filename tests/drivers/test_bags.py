"""ROS 2 recordings as mcap-ros2-support writes them: positions of the usual messages, readings by a map of topics."""

import json
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest
from mcap_ros2.writer import Writer
from typer.testing import CliRunner

from drivers.positions.bags import is_bag
from drivers.positions.readings import read_readings
from drivers.positions.source import open_file, poses_of
from drivers.positions.tracks import ONLY, read_track
from fieldkit.channel.antenna_file import AntennaFile, dump_antenna
from fieldkit.channel.model import Antenna
from fieldkit.cli import build
from fieldkit.clock import RealClock
from fieldkit.errors import ConfigError, DataError
from fieldkit.geo import FieldFrame
from fieldkit.messages import RssReading
from fieldkit.ports import DriverContext

S = 1_000_000_000
T0_S = 1_700_000_000
FRAME = FieldFrame(47.3977, 8.5456)
HEADER = """std_msgs/Header header
{body}
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
POSE = """================================================================================
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
================================================================================
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
================================================================================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
"""
DEFINITIONS = {
    # common_interfaces, rolling, as rosbag2 stores them.
    "sensor_msgs/msg/NavSatFix": HEADER.format(
        body="sensor_msgs/NavSatStatus status\nfloat64 latitude\nfloat64 longitude\nfloat64 altitude\n"
        "float64[9] position_covariance\nuint8 COVARIANCE_TYPE_UNKNOWN=0\nuint8 position_covariance_type"
    )
    + "=" * 80
    + "\nMSG: sensor_msgs/NavSatStatus\nint8 STATUS_NO_FIX=-1\nint8 status\nuint16 service\n",
    "nav_msgs/msg/Odometry": HEADER.format(
        body="string child_frame_id\ngeometry_msgs/PoseWithCovariance pose"
    )
    + "=" * 80
    + "\nMSG: geometry_msgs/PoseWithCovariance\ngeometry_msgs/Pose pose\nfloat64[36] covariance\n"
    + POSE,
    "geometry_msgs/msg/PoseStamped": HEADER.format(body="geometry_msgs/Pose pose") + POSE,
    "field_msgs/msg/Packet": HEADER.format(
        body="string mac\nfield_msgs/Radio radio\nuint8[] payload\n" + "=" * 80 + "\n"
        "MSG: field_msgs/Radio\nint8 rssi\nuint8 channel"
    ),
}

Row = tuple[str, str, float, dict[str, Any]]
"""Topic, kind, seconds, message."""


def write(path: Path, rows: Iterable[Row]) -> Path:
    with path.open("wb") as stream, Writer(stream) as writer:
        schemas = {kind: writer.register_msgdef(kind, text) for kind, text in DEFINITIONS.items()}
        for topic, kind, at_s, message in rows:
            writer.write_message(topic, schemas[kind], message, round((T0_S + at_s) * S), sequence=0)
    return path


def header(at_s: float) -> dict[str, Any]:
    return {"stamp": {"sec": T0_S + int(at_s), "nanosec": round(at_s % 1 * S)}, "frame_id": "map"}


def fix(
    topic: str, at_s: float, east_m: float, north_m: float, status: int = 0, variance: float = 9.0
) -> Row:
    lat, lon, alt = FRAME.to_geodetic(east_m, north_m)
    covariance = [variance, 0.0, 0.0, 0.0, variance, 0.0, 0.0, 0.0, 16.0]
    message = {
        "header": header(at_s),
        "status": {"status": status, "service": 1},
        "latitude": lat,
        "longitude": lon,
        "altitude": alt,
        "position_covariance": covariance,
        "position_covariance_type": 2 if variance else 0,
    }
    return topic, "sensor_msgs/msg/NavSatFix", at_s + 0.3, message  # written later than it was measured


def pose(east_m: float, north_m: float, up_m: float, yaw_deg: float) -> dict[str, Any]:
    half = math.radians(yaw_deg) / 2
    return {
        "position": {"x": east_m, "y": north_m, "z": up_m},
        "orientation": {"x": 0.0, "y": 0.0, "z": math.sin(half), "w": math.cos(half)},
    }


def odometry(topic: str, at_s: float, *place: float) -> Row:
    covariance = [0.0] * 36
    covariance[0], covariance[7] = 0.04, 0.04
    inner = {"pose": pose(*place), "covariance": covariance}
    message = {"header": header(at_s), "child_frame_id": "base", "pose": inner}
    return topic, "nav_msgs/msg/Odometry", at_s, message


def packet(topic: str, at_s: float, rssi: int, mac: str = "aa:bb") -> Row:
    radio = {"rssi": rssi, "channel": 15}
    message = {"header": header(at_s), "mac": mac, "radio": radio, "payload": list(range(5))}
    return topic, "field_msgs/msg/Packet", at_s, message


# -- positions -------------------------------------------------------------------------------------------------


def test_a_satellite_fix_has_its_own_time_place_and_error(tmp_path: Path) -> None:
    bag = write(tmp_path / "walk.mcap", [fix("/fix", k, 2.0 * k, 1.0) for k in range(5)])
    track = read_track(bag)
    assert is_bag(bag) and track.geodetic and {spot.robot for spot in track.spots} == {ONLY}
    poses = poses_of(track, FRAME)
    assert [pose.t_ns for pose in poses] == [(T0_S + k) * S for k in range(5)], (
        "of the header, not of the writing"
    )
    assert [pose.east_m for pose in poses] == pytest.approx([0.0, 2.0, 4.0, 6.0, 8.0], abs=1e-6)
    assert poses[0].sigma_m == pytest.approx(3.0)


def test_no_fix_is_no_position_and_an_unknown_covariance_is_a_plain_receivers(tmp_path: Path) -> None:
    rows = [fix("/fix", 0, 0.0, 0.0, status=-1), fix("/fix", 1, 1.0, 0.0, variance=0.0)]
    track = read_track(write(tmp_path / "walk.mcap", rows))
    assert track.skipped == 1 and [spot.sigma_m for spot in track.spots] == [2.5]


@pytest.mark.parametrize("yaw_deg, heading_deg", [(0.0, 90.0), (90.0, 0.0), (180.0, 270.0), (-45.0, 135.0)])
def test_odometry_turns_from_east_counter_clockwise_and_we_from_north_clockwise(
    yaw_deg: float, heading_deg: float, tmp_path: Path
) -> None:
    track = read_track(write(tmp_path / "r.mcap", [odometry("/odom", 1.5, 3.0, 4.0, 0.5, yaw_deg)]))
    (spot,) = track.spots
    assert not track.geodetic and track.heights
    assert (spot.first, spot.second, spot.up_m) == (3.0, 4.0, 0.5)
    assert spot.heading_deg == pytest.approx(heading_deg) and spot.sigma_m == pytest.approx(0.2)
    assert spot.t_ns == T0_S * S + S // 2 + S


def test_robots_are_named_by_their_topics(tmp_path: Path) -> None:
    rows = [
        (
            "/r1/pose",
            "geometry_msgs/msg/PoseStamped",
            0.0,
            {"header": header(0.0), "pose": pose(1.0, 2.0, 0.0, 0.0)},
        ),
        (
            "/r2/pose",
            "geometry_msgs/msg/PoseStamped",
            0.0,
            {"header": header(0.0), "pose": pose(5.0, 6.0, 0.0, 0.0)},
        ),
    ]
    track = read_track(write(tmp_path / "r.mcap", rows))
    assert {spot.robot: spot.first for spot in track.spots} == {"r1": 1.0, "r2": 5.0}


def test_a_message_without_a_stamp_counts_when_it_was_written(tmp_path: Path) -> None:
    topic, kind, at_s, message = odometry("/odom", 4.0, 1.0, 1.0, 0.0, 0.0)
    message["header"]["stamp"] = {"sec": 0, "nanosec": 0}
    (spot,) = read_track(write(tmp_path / "r.mcap", [(topic, kind, at_s, message)])).spots
    assert spot.t_ns == (T0_S + 4) * S


def test_satellites_go_before_odometry_and_what_is_left_out_is_said(tmp_path: Path) -> None:
    rows = [fix("/fix", 0, 1.0, 1.0), odometry("/odom", 0, 9.0, 9.0, 0.0, 0.0)]
    track = read_track(write(tmp_path / "r.mcap", rows))
    assert track.geodetic and len(track.spots) == 1
    assert "/odom" in " ".join(track.notes)


def test_a_folder_of_a_bag_is_read_whole(tmp_path: Path) -> None:
    folder = tmp_path / "rosbag2_2026"
    folder.mkdir()
    write(folder / "bag_0.mcap", [fix("/fix", k, k, 0.0) for k in range(3)])
    write(folder / "bag_1.mcap", [fix("/fix", k, k, 0.0) for k in range(3, 5)])
    assert len(read_track(folder).spots) == 5


def test_a_bag_that_was_cut_off_gives_what_came_before(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=512)
        schema = writer.register_msgdef("sensor_msgs/msg/NavSatFix", DEFINITIONS["sensor_msgs/msg/NavSatFix"])
        for k in range(200):
            _, _, at_s, message = fix("/fix", k, 0.1 * k, 0.0)
            writer.write_message("/fix", schema, message, round((T0_S + at_s) * S))
        writer.finish()
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    track = read_track(path)
    assert 20 < len(track.spots) < 200 and any("not readable to its end" in note for note in track.notes)


def test_a_bag_without_positions_names_what_is_read(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"no topic has positions.*NavSatFix"):
        read_track(write(tmp_path / "r.mcap", [packet("/packets", 0, -60)]))


async def test_a_bag_is_a_position_source(tmp_path: Path) -> None:
    bag = write(tmp_path / "r.mcap", [fix("/fix", k, k, 0.0) for k in range(3)])
    around = DriverContext(RealClock(), FRAME)
    async with open_file({"path": str(bag), "robot": "ada", "at_once": True}, around) as source:
        assert [pose.robot async for pose in source.poses()] == ["ada"] * 3


# -- readings --------------------------------------------------------------------------------------------------


def mapped(folder: Path, text: str) -> Path:
    path = folder / "topics.toml"
    path.write_text(text)
    return path


def test_a_map_of_topics_makes_messages_readings(tmp_path: Path) -> None:
    bag = write(tmp_path / "r.mcap", [packet("/r1/packets", k, -60 - k) for k in range(3)])
    topics = mapped(
        tmp_path,
        '["/r1/packets"]\nrss = "radio.rssi"\nsource = "mac"\nchannel = "radio.channel"\nrobot = "r1"\n',
    )
    heard = read_readings(bag, topics=topics)
    assert heard == [RssReading((T0_S + k) * S, "r1", -60.0 - k, "lines", 15, "aa:bb") for k in range(3)]


@pytest.mark.parametrize(
    "text, says",
    [
        ("", r"--topics FILE. It has /packets \(field_msgs/Packet\)"),
        ('["/other"]\nrss = "rssi"\n', r"no reading on /other; it has /packets"),
        ('["/packets"]\nrss = "rssi"\n', "no number at 'rssi'"),
        ('["/packets"]\nrss = "radio.channel"\n', "no number at|no reading on|no radio receives"),
    ],
)
def test_a_map_that_matches_nothing_says_what_there_is(text: str, says: str, tmp_path: Path) -> None:
    bag = write(tmp_path / "r.mcap", [packet("/packets", 0, -60)])
    if "channel" in text:
        text = text.replace("radio.channel", "payload")
    with pytest.raises(DataError, match=says):
        read_readings(bag, topics=mapped(tmp_path, text) if text else None)


@pytest.mark.parametrize(
    "text, says",
    [
        ('["/a"]\nsource = "mac"\n', "the path of the strength"),
        ('["/a"]\nrss = "x"\nunit = "volts"\n', "option 'unit'"),
        ('["/a"]\nrss = "x"\nrssi = "y"\n', "no such key: rssi"),
        ("= 3", "cannot be read"),
    ],
)
def test_a_map_that_makes_no_sense_is_refused(text: str, says: str, tmp_path: Path) -> None:
    bag = write(tmp_path / "r.mcap", [packet("/packets", 0, -60)])
    with pytest.raises(ConfigError, match=says):
        read_readings(bag, topics=mapped(tmp_path, text))


def test_a_survey_finds_a_transmitter_from_a_bag_alone(tmp_path: Path) -> None:
    """A walk round a transmitter at (40, 30) m, positions and packets in one bag; the law without noise."""
    antenna = Antenna(2.0, -40.0, 3.0, -95.0)
    rows: list[Row] = []
    for k in range(160):
        angle = 2.0 * math.pi * k / 80
        radius_m = 12.0 if k < 80 else 25.0
        east, north = 40.0 + radius_m * math.sin(angle), 30.0 + radius_m * math.cos(angle)
        rows += [fix("/fix", k, east, north, variance=1.0)]
        rows += [packet("/packets", k + 0.01, round(-40.0 - 20.0 * math.log10(radius_m)))]
    bag = write(tmp_path / "r.mcap", rows)
    (tmp_path / "antenna.toml").write_text(dump_antenna(AntennaFile(antenna)))
    topics = mapped(tmp_path, '["/packets"]\nrss = "radio.rssi"\n')
    result = CliRunner().invoke(
        build(),
        [
            "survey",
            str(bag),
            str(bag),
            "--antenna",
            str(tmp_path / "antenna.toml"),
            "--topics",
            str(topics),
            "--json",
        ],
    )
    assert result.exit_code == 0, result.output
    (best, *_) = json.loads(result.stdout)["candidates"]
    off_m = math.dist(FRAME.to_local(best["lat_deg"], best["lon_deg"])[:2], (40.0, 30.0))
    assert off_m < 3.0
