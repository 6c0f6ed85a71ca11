"""Cursor on Target: events by the rules of its schema, over real sockets on this machine, and as a package."""

import asyncio
import contextlib
import io
import re
import socket
import struct
import threading
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from fieldkit.clock import wall_sleep
from fieldkit.errors import ConfigError
from fieldkit.messages import Operator, Pose, SourceEstimate, Tick
from fieldkit.recording import cot
from fieldkit.recording.cot import Marker
from fieldkit.recording.export import export
from fieldkit.recording.log import open_log
from fieldkit.settings import ELLIPSE_90
from mission.core.mission_file import parse_mission
from mission.core.walk_text import WalkOptions, walk_text
from mission.lab.synthetic import record_simulated, small_mission
from mission.maps.cot import CotSender, markers
from mission.maps.present import Latest

S = 1_000_000_000
T_NS = 1_790_000_000 * S
QUICK_S = 0.2

# The rules of MITRE's Event.xsd, version 2.0 (public release): what an event must have, and what it looks like.
TYPE = re.compile(r"\w+(-\w+)*(;[^;]*)?")
HOW = re.compile(r"\w(-\w+)*")
DATE_TIME = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d+)?Z")


def checked(xml: bytes) -> ElementTree.Element:
    """An event that keeps to the schema."""
    event = ElementTree.fromstring(xml)
    assert event.tag == "event" and event.get("version") == "2.0"
    assert event.get("uid") and TYPE.fullmatch(event.get("type", "")) and HOW.fullmatch(event.get("how", ""))
    moments = []
    for name in ("time", "start", "stale"):
        text = event.get(name, "")
        assert DATE_TIME.fullmatch(text), f"{name}={text!r}"
        moments.append(datetime.fromisoformat(text))
    assert moments[0] == moments[1] < moments[2]
    points = event.findall("point")
    assert len(points) == 1 and len(event.findall("detail")) == 1
    numbers = {name: float(points[0].attrib[name]) for name in ("lat", "lon", "hae", "ce", "le")}
    assert -90.0 <= numbers["lat"] <= 90.0 and -180.0 <= numbers["lon"] <= 180.0
    assert numbers["ce"] >= 0.0 and numbers["le"] >= 0.0
    return event


def told(folder: Path) -> Latest:
    latest = Latest(small_mission(folder))
    latest.event(1, T_NS, Tick(T_NS))
    latest.event(2, T_NS, Pose(T_NS, "r1", 3.0, 4.0, 0.0, 90.0, 2.0))
    latest.event(3, T_NS, Operator(T_NS, "mark", "r1"))
    cov = np.array([[9.0, 0.0], [0.0, 4.0]])
    found = SourceEstimate(1, 5.0, 6.0, cov, 5, 9.0, 0.1, 1.0, 0.93, "found", name="aa:bb")
    candidate = replace(found, ident=2, state="candidate", east_m=1.0)
    nowhere = replace(found, ident=3, state="inconsistent")
    latest.sources(4, T_NS, [found, candidate, nowhere])
    return latest


def test_an_event_says_what_where_how_well_and_how_long(tmp_path: Path) -> None:
    present = told(tmp_path).present()
    events = {"-".join(m.uid.split("-")[-2:]): checked(cot.event(m)) for m in markers(present, 5.0)}
    assert events.keys() == {"source-1", "source-2", "robot-r1", "mark-1"}, (
        "no position is claimed of source 3"
    )
    source = events["source-1"]
    assert source.get("type") == "a-u-G" and source.get("how") == "m-f"
    point = source.find("point")
    assert point is not None
    assert float(point.attrib["ce"]) == pytest.approx(ELLIPSE_90 * 3.0, abs=0.05), "of the 90 % region"
    place = present.frame.to_local(float(point.attrib["lat"]), float(point.attrib["lon"]))[:2]
    assert place == pytest.approx((5.0, 6.0), abs=0.05), "to centimetres, not to pytak's four digits"
    contact = source.find("detail/contact")
    assert contact is not None and contact.attrib["callsign"] == "source 1"
    assert "sender aa:bb" in (source.findtext("detail/remarks") or "")
    assert source.get("time") == "2026-09-21T14:13:20.000000Z"


def test_what_is_only_suspected_fades_and_what_was_found_stays(tmp_path: Path) -> None:
    lasts_s = {m.callsign: m.stale_s for m in markers(told(tmp_path).present(), 5.0)}
    assert lasts_s["source 1"] == 86_400.0 and lasts_s["source 2?"] == 20.0 and lasts_s["r1"] == 20.0


def test_people_robots_and_marks_are_told_apart(tmp_path: Path) -> None:
    latest = told(tmp_path)
    safety = replace(latest._mission.safety, altitude_m={"r2": 10.0})
    latest._mission = replace(latest._mission, safety=safety)
    latest.event(5, T_NS, Pose(T_NS, "r2", 1.0, 1.0))
    kinds = {m.callsign: (m.kind, m.how) for m in markers(latest.present(), 5.0)}
    assert kinds["r1"] == ("a-f-G", "m-g") and kinds["r2"] == ("a-f-A-M-H-Q", "m-g")
    assert kinds["r1: here"] == ("b-m-p-s-m", "h-e")


def test_uids_are_the_same_for_the_same_thing_and_others_for_another_mission(tmp_path: Path) -> None:
    latest = told(tmp_path)
    before = {m.uid for m in markers(latest.present(), 5.0)}
    latest.event(9, T_NS + 60 * S, Tick(T_NS + 60 * S))
    assert {m.uid for m in markers(latest.present(), 5.0)} == before
    later = Latest(latest._mission)
    later.event(1, T_NS + 9 * S, Tick(T_NS + 9 * S))
    later.sources(2, T_NS, list(latest.present().sources))
    assert not before & {m.uid for m in markers(later.present(), 5.0)}


def test_names_with_marks_of_xml_in_them_do_no_harm() -> None:
    marker = Marker("u", "a-u-G", "m-f", 1.0, 2.0, None, '<"ada" & co>', "a<b", T_NS, 10.0)
    contact = checked(cot.event(marker)).find("detail/contact")
    assert contact is not None and contact.attrib["callsign"] == '<"ada" & co>'


# -- on the wire -------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def listening(group: str | None = None) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire:
        wire.bind(("127.0.0.1" if group is None else "", 0))
        wire.settimeout(10.0)
        if group is not None:
            member = struct.pack("4s4s", socket.inet_aton(group), socket.inet_aton("0.0.0.0"))
            try:
                wire.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
            except OSError:
                pytest.skip("this machine has no interface for multicast")
        yield wire


@pytest.mark.parametrize("group", [None, "239.2.3.1"])
def test_datagrams_each_hold_one_event(group: str | None, tmp_path: Path) -> None:
    with listening(group) as wire:
        address = f"udp://{group or '127.0.0.1'}:{wire.getsockname()[1]}"
        with CotSender(told(tmp_path), (address,), QUICK_S):
            got = [checked(wire.recv(65_536)) for _ in range(8)]
    assert len({event.get("uid") for event in got}) == 4


class Server:
    """A TAK server as far as it goes: takes what comes on one port, may hang up, may not be there."""

    def __init__(self) -> None:
        self.taken = b""
        self.connections = 0
        self.port = 0
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        self._writers: list[asyncio.StreamWriter] = []

    def _do(self, work: Any) -> Any:
        return asyncio.run_coroutine_threadsafe(work, self._loop).result(10.0)

    def open(self) -> None:
        async def serve() -> None:
            self._server = await asyncio.start_server(self._take, "127.0.0.1", self.port)
            self.port = self._server.sockets[0].getsockname()[1]

        self._do(serve())

    async def _take(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.connections += 1
        self._writers.append(writer)
        writer.write(b"<event version='2.0'/>")  # servers talk too
        with contextlib.suppress(OSError):
            while data := await reader.read(65_536):
                self.taken += data

    def hang_up(self) -> None:
        async def close() -> None:
            self._server.close()
            for writer in self._writers:
                writer.transport.abort()
            self._writers.clear()
            await asyncio.sleep(0)

        self._do(close())

    def close(self) -> None:
        self.hang_up()

        async def rest() -> None:
            others = asyncio.all_tasks() - {asyncio.current_task()}
            if others:
                await asyncio.wait(others)

        self._do(rest())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(10.0)
        self._loop.close()


@pytest.fixture
def server() -> Iterator[Server]:
    made = Server()
    made.open()
    yield made
    made.close()


def until(condition: Any) -> None:
    for _ in range(1500):
        if condition():
            return
        wall_sleep(0.02)
    raise AssertionError("did not happen")


def events_of(stream: bytes) -> list[ElementTree.Element]:
    parts = [part for part in stream.split(b"<?xml") if part]
    return [checked(b"<?xml" + part) for part in parts if part.rstrip().endswith(b"</event>")]


def test_a_server_gets_events_one_after_the_other(server: Server, tmp_path: Path) -> None:
    with CotSender(told(tmp_path), (f"tcp://127.0.0.1:{server.port}",), QUICK_S):
        until(lambda: len(events_of(server.taken)) >= 8)


def test_a_server_that_hangs_up_is_said_once_and_found_again(
    server: Server, tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mission.maps.cot.AGAIN_S", 0.1)
    address = f"tcp://127.0.0.1:{server.port}"
    with CotSender(told(tmp_path), (address,), QUICK_S):
        until(lambda: server.taken)
        server.hang_up()
        until(lambda: "cannot be reached" in caplog.text)
        wall_sleep(0.5)
        server.taken = b""
        server.open()
        until(lambda: server.connections == 2 and len(events_of(server.taken)) >= 4)
    assert caplog.text.count("cannot be reached") == 1 and caplog.text.count("reached again") == 1


def test_one_address_that_is_dead_keeps_no_other_from_its_events(
    server: Server, tmp_path: Path, unused_tcp_port: int
) -> None:
    addresses = (f"tcp://127.0.0.1:{unused_tcp_port}", f"tcp://127.0.0.1:{server.port}")
    with CotSender(told(tmp_path), addresses, QUICK_S) as sender:
        until(lambda: len(events_of(server.taken)) >= 4)
    assert sender.sent[addresses[0]] == 0


def test_the_last_present_goes_out_at_the_end(server: Server, tmp_path: Path) -> None:
    latest = told(tmp_path)
    with CotSender(latest, (f"tcp://127.0.0.1:{server.port}",), 600.0):
        until(lambda: len(events_of(server.taken)) == 4)
        latest.sources(5, T_NS, [replace(latest.present().sources[0], ident=77)])
    until(lambda: any(str(event.get("uid")).endswith("source-77") for event in events_of(server.taken)))


def test_nothing_goes_out_before_the_mission_has_begun(server: Server, tmp_path: Path) -> None:
    with CotSender(Latest(small_mission(tmp_path)), (f"tcp://127.0.0.1:{server.port}",), QUICK_S):
        until(lambda: server.connections == 1)
        wall_sleep(3 * QUICK_S)
    assert not server.taken


# -- what a file may say ------------------------------------------------------------------------------------------


def mission_text(maps: str) -> str:
    receiver = {"driver": "lines", "port": "-", "map": "rylr"}
    return walk_text(WalkOptions(receiver, "/dev/x", "a.toml", (47.0, 8.0))) + maps


def test_nobody_is_told_unless_the_file_says_so() -> None:
    assert parse_mission(mission_text(""), "walk").maps.cot == ()
    said = parse_mission(
        mission_text('[maps]\ncot = ["udp://239.2.3.1:6969", "tcp://tak.local:8087"]\n'), "walk"
    )
    assert len(said.maps.cot) == 2


def test_a_walk_without_a_file_tells_whom_it_is_told_to() -> None:
    receiver = {"driver": "lines", "port": "-", "map": "rylr"}
    options = WalkOptions(receiver, "/dev/x", "a.toml", (47.0, 8.0), cot=("udp://239.2.3.1:6969",))
    assert parse_mission(walk_text(options), "walk").maps.cot == ("udp://239.2.3.1:6969",)


@pytest.mark.parametrize(
    "address", ["239.2.3.1:6969", "http://x:1", "udp://239.2.3.1", "tcp://a b:1", "udp://[x]:y"]
)
def test_an_address_that_is_none_stops_before_the_start(address: str) -> None:
    with pytest.raises(ConfigError, match=r"maps\.cot.*expected udp://HOST:PORT"):
        parse_mission(mission_text(f'[maps]\ncot = ["{address}"]\n'), "walk")


# -- after the mission --------------------------------------------------------------------------------------------


def test_a_recording_becomes_a_package_whose_manifest_names_its_events(tmp_path: Path) -> None:
    log = open_log(record_simulated(tmp_path, duration_s=60.0, sources_found=9))
    (path,) = export(log, tmp_path / "found.zip", ("poses",))
    with zipfile.ZipFile(io.BytesIO(path.read_bytes())) as archive:
        manifest = ElementTree.fromstring(archive.read("MANIFEST/manifest.xml"))
        entries = [content.attrib["zipEntry"] for content in manifest.iter("Content")]
        assert sorted([*entries, "MANIFEST/manifest.xml"]) == sorted(archive.namelist())
        events = [checked(archive.read(entry)) for entry in entries]
    calls = {event.find("detail/contact").attrib["callsign"] for event in events}  # type: ignore[union-attr]
    assert calls == {"r1", "r2", "r3", "r4"}
    uids = [parameter.attrib["value"] for parameter in manifest.findall("Contents/Content/Parameter")]
    assert uids == [event.get("uid") for event in events]
    again = export(log, tmp_path / "again.zip", ("poses",))[0]
    assert again.read_bytes() == path.read_bytes()
