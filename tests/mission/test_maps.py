"""What other maps get of a mission: GeoJSON, KML, places in other words; over a real socket where there is one."""

import json
import socket
from contextlib import closing
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import Request, urlopen
from xml.etree import ElementTree

import numpy as np
import pytest

from fieldkit.coordinates import coordinates, from_utm
from fieldkit.errors import ConfigError
from fieldkit.geo import FieldFrame
from fieldkit.messages import Operator, Pose, SourceEstimate, Tick
from fieldkit.settings import ELLIPSE_90
from mission.lab.synthetic import small_mission
from mission.maps.geojson import collection, error_90_m
from mission.maps.kml import KML, document, network_link
from mission.maps.present import Latest
from mission.page import serve

S = 1_000_000_000


def estimate(ident: int, east_m: float, north_m: float, state: str = "found") -> SourceEstimate:
    cov = np.array([[4.0, 1.0], [1.0, 2.0]])
    return SourceEstimate(ident, east_m, north_m, cov, 5, 9.0, 0.1, 1.0, 0.93, state)  # type: ignore[arg-type]


def feed(latest: Latest) -> None:
    latest.event(1, S, Pose(S, "r1", 3.0, 4.0, 0.0, 90.0, 0.5))
    latest.event(2, S, Tick(S))
    latest.event(3, S, Operator(S, "mark", "r1"))
    latest.event(4, S, Operator(S, "mark", "r2"))
    latest.sources(5, S, [estimate(1, 5.0, 6.0), estimate(2, 1.0, 1.0, "inconsistent")])


# -- words -------------------------------------------------------------------------------------------------------


def test_the_washington_monument_is_where_its_grid_says() -> None:
    """The example of the United States National Grid (FGDC-STD-011): 18S UJ 23480 06470, to ten metres."""
    said = coordinates(38.889464, -77.035242)
    assert said.mgrs[:5] == "18SUJ" and said.mgrs[5:9] == "2348" and said.mgrs[10:14] == "0647"
    assert said.utm.startswith("18S 3234") and said.lat_lon == "38.889464, -77.035242"


@pytest.mark.parametrize(
    "place", [(47.3977, 8.5456), (-33.86, 151.2), (60.5, 5.0), (78.2, 15.6), (0.5, -0.5), (-79.0, 179.9)]
)
def test_two_independent_packages_agree_to_the_metre(place: tuple[float, float]) -> None:
    """MGRS (GEOTRANS) cuts off what UTM (Krüger's series in `utm`) rounds; Norway has zones of its own."""
    said = coordinates(*place)
    zone, east, north = said.utm.split()
    assert said.mgrs.startswith(zone)
    digits = said.mgrs[len(zone) + 2 :]
    for utm, grid in ((east, digits[:5]), (north, digits[5:])):
        off = (int(utm) - int(grid)) % 100_000
        assert off in (0, 1)
    back = from_utm(float(east), float(north), int(zone[:-1]), northern=zone[-1] >= "N")
    assert back == pytest.approx(place, abs=2e-5)


def test_near_the_poles_there_is_no_utm_and_nowhere_is_refused() -> None:
    assert coordinates(85.0, 10.0).utm == "" and coordinates(85.0, 10.0).mgrs.startswith("Z")
    with pytest.raises(ConfigError, match="no place on Earth"):
        coordinates(91.0, 0.0)
    with pytest.raises(ConfigError, match="UTM zone 99"):
        from_utm(5e5, 5e6, 99, northern=True)


# -- GeoJSON and KML ---------------------------------------------------------------------------------------------


def test_the_present_has_what_is_claimed_and_nothing_else(tmp_path: Path) -> None:
    latest = Latest(small_mission(tmp_path))
    feed(latest)
    features = {each["id"]: each for each in collection(latest.present())["features"]}
    assert features.keys() == {"source-1", "region-1", "robot-r1", "mark-1"}, (
        "no position is claimed of source 2"
    )
    frame: FieldFrame = latest.present().frame
    lon, lat = features["source-1"]["geometry"]["coordinates"]
    assert frame.to_local(lat, lon)[:2] == pytest.approx((5.0, 6.0), abs=1e-3)
    assert features["source-1"]["properties"]["mgrs"] == coordinates(lat, lon).mgrs
    ring = features["region-1"]["geometry"]["coordinates"][0]
    assert ring[0] == ring[-1] and len(ring) > 20


def test_the_90_percent_radius_is_the_longer_half_axis() -> None:
    source = estimate(1, 0.0, 0.0)
    rng = np.random.default_rng(1)
    off = np.hypot(*rng.multivariate_normal((0.0, 0.0), source.cov_m2, 20_000).T)
    assert error_90_m(source) == pytest.approx(ELLIPSE_90 * np.sqrt(3.0 + np.sqrt(2.0)))
    assert 0.9 < float((off < error_90_m(source)).mean()) < 0.97


def test_kml_places_what_geojson_places(tmp_path: Path) -> None:
    latest = Latest(small_mission(tmp_path))
    feed(latest)
    root = ElementTree.fromstring(document(latest.present()))
    marks = {mark.get("id"): mark for mark in root.iter(f"{{{KML}}}Placemark")}
    features = {each["id"]: each for each in collection(latest.present())["features"]}
    assert marks.keys() == features.keys()
    point = marks["source-1"].findtext(f".//{{{KML}}}coordinates") or ""
    assert [float(part) for part in point.split(",")] == features["source-1"]["geometry"]["coordinates"]
    link = ElementTree.fromstring(network_link("m", "http://10.0.0.1:8321/present.kml"))
    assert link.findtext(f".//{{{KML}}}href") == "http://10.0.0.1:8321/present.kml"


# -- over HTTP ---------------------------------------------------------------------------------------------------


def fetched(address: str, host: str | None = None) -> bytes:
    request = Request(address, headers={} if host is None else {"Host": host})
    with urlopen(request, timeout=10) as answer:
        return bytes(answer.read())


def test_the_page_answers_other_maps(tmp_path: Path) -> None:
    with serve.live(small_mission(tmp_path)) as shown:
        feed(shown.follower.view.latest)
        base = shown.page.address
        found = json.loads(fetched(base + "sources.geojson"))
        assert found["features"][0]["id"] == "source-1"
        href = ElementTree.fromstring(fetched(base + "network.kml")).findtext(f".//{{{KML}}}href")
        assert href == base + "present.kml"
        assert b"source 1 (found)" in fetched(href)
        said = json.loads(fetched(base + "where?east_m=5&north_m=6"))
        assert (
            said["metres"] == "5.0 m E, 6.0 m N"
            and said["mgrs"] == found["features"][0]["properties"]["mgrs"]
        )


@pytest.mark.parametrize(
    "query", ["", "?east_m=1", "?east_m=a&north_m=1", "?east_m=nan&north_m=1", "?east_m=1e9&north_m=0"]
)
def test_what_is_no_place_is_refused_in_words(query: str, tmp_path: Path) -> None:
    with serve.live(small_mission(tmp_path)) as shown, pytest.raises(HTTPError) as refused:
        fetched(f"{shown.page.address}where{query}")
    assert refused.value.code == 400


def test_foreign_names_get_no_places(tmp_path: Path) -> None:
    with serve.live(small_mission(tmp_path)) as shown:
        for path in ("sources.geojson", "sources.ndjson", "where?east_m=1&north_m=1", "present.kml"):
            with pytest.raises(HTTPError) as refused:
                fetched(shown.page.address + path, host="evil.example")
            assert refused.value.code == 421


def test_the_stream_gives_a_line_for_each_new_present(tmp_path: Path) -> None:
    with serve.live(small_mission(tmp_path)) as shown:
        latest = shown.follower.view.latest
        feed(latest)
        with closing(socket.create_connection((shown.page.host, shown.page.port), timeout=10)) as wire:
            wire.sendall(b"GET /sources.ndjson HTTP/1.1\r\nHost: localhost\r\n\r\n")
            lines = wire.makefile("rb")
            times = []
            for line in lines:
                if line.startswith(b"{"):
                    times.append(json.loads(line)["time"])
                    latest.event(9, (1 + len(times)) * S, Tick((1 + len(times)) * S))
                if len(times) == 3:
                    break
    assert times == ["1970-01-01T00:00:01.000Z", "1970-01-01T00:00:02.000Z", "1970-01-01T00:00:03.000Z"]
