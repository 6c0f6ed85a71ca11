"""Pictures under the map: tiles and geo-referenced pictures lie where they should, and what is of elsewhere is said."""

import io
import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest
import utm
from PIL import Image, TiffImagePlugin
from typer.testing import CliRunner

from fieldkit.cli import build
from fieldkit.errors import ConfigError
from fieldkit.recording.reader import open_recording
from mission.core.mission_file import Mission, parse_mission, read_mission
from mission.core.walk_text import WalkOptions, walk_text
from mission.lab.study.walk import walk_mission
from mission.lab.synthetic import record, small_mission
from mission.maps import background as module
from mission.maps.background import Background, background_or_none, read_background
from mission.maps.georeference import to_degrees
from mission.replay.replay import recorded_mission

SIDE_M = 300.0


def walk(folder: Path, background: str, crs: str = "") -> Mission:
    """A field of 300 m with a background."""
    mission = walk_mission(1)
    field = mission.file.field.model_copy(update={"background": background, "background_crs": crs})
    file = mission.file.model_copy(update={"field": field})
    return replace(mission, file=file, where=str(folder / "mission.toml"))


def read(mission: Mission) -> Background:
    found = read_background(mission)
    assert found is not None
    return found


def png(colour: tuple[int, int, int] = (90, 120, 90), side: int = 256) -> bytes:
    out = io.BytesIO()
    Image.new("RGB", (side, side), colour).save(out, "PNG")
    return out.getvalue()


def mbtiles(path: Path, zooms: range, lat: float, lon: float, **about: str) -> Path:
    """Tiles round a place, as the MBTiles specification 1.3 stores them: rows counted from the south."""
    with closing(sqlite3.connect(path)) as file:
        file.execute("create table metadata (name text, value text)")
        file.execute(
            "create table tiles (zoom_level integer, tile_column integer, tile_row integer, tile_data blob)"
        )
        file.executemany("insert into metadata values (?, ?)", ({"format": "png"} | about).items())
        for zoom in zooms:
            column, row = int(module._column(lon, zoom)), int(module._row(lat, zoom))
            for east in range(-3, 4):
                for south in range(-3, 4):
                    place = (zoom, column + east, 2**zoom - 1 - (row + south))
                    file.execute("insert into tiles values (?, ?, ?, ?)", (*place, png()))
        file.commit()
    return path


# -- tiles -------------------------------------------------------------------------------------------------------


def test_tiles_are_counted_as_the_web_counts_them() -> None:
    """The example of the OpenStreetMap wiki, "Slippy map tilenames"."""
    assert int(module._column(139.7006793, 18)) == 232798 and int(module._row(35.6590699, 18)) == 103246


def test_tiles_over_the_field_are_taken_in_the_finest_detail_that_is_not_too_many(tmp_path: Path) -> None:
    mission = walk(tmp_path, "map.mbtiles")
    lat, lon, _ = mission.frame.to_geodetic(SIDE_M / 2, SIDE_M / 2)
    credit = '<a href="https://x">© OpenStreetMap contributors</a>'
    mbtiles(tmp_path / "map.mbtiles", range(12, 18), lat, lon, attribution=credit)
    found = read(mission)
    assert found.covered == 1.0 and found.credit == "© OpenStreetMap contributors"
    assert {picture.name.split("-")[0] for picture in found.pictures} == {"17"}
    for picture in found.pictures:
        nw, ne, sw = picture.corners_m
        zoom, column, row = map(int, picture.name.split("-"))
        middle = ((ne[0] + sw[0]) / 2, (ne[1] + sw[1]) / 2)
        at = mission.frame.to_geodetic(*middle)
        assert (int(module._column(at[1], zoom)), int(module._row(at[0], zoom))) == (column, row)
        assert ne[0] - nw[0] == pytest.approx(nw[1] - sw[1], rel=5e-3), "square, but for the ellipsoid"


def test_a_file_with_little_detail_is_shown_as_far_as_it_goes(tmp_path: Path) -> None:
    mission = walk(tmp_path, "map.mbtiles")
    mbtiles(tmp_path / "map.mbtiles", range(10, 15), *mission.frame.to_geodetic(150.0, 150.0)[:2])
    assert {picture.name.split("-")[0] for picture in read(mission).pictures} == {"14"}


def test_a_tile_file_of_elsewhere_says_of_where_it_is(tmp_path: Path) -> None:
    mbtiles(tmp_path / "map.mbtiles", range(12, 18), 52.52, 13.405, bounds="13.3,52.4,13.5,52.6")
    with pytest.raises(
        ConfigError,
        match=r"a map of elsewhere: latitude 52.4000 to 52.6000.* 6\d\d km away; the field is at 47",
    ):
        read(walk(tmp_path, "map.mbtiles"))


@pytest.mark.parametrize("content", [b"", b"no database at all, but long enough to be looked at" * 40])
def test_what_is_no_tile_file_is_said(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "map.mbtiles").write_bytes(content)
    with pytest.raises(ConfigError, match="not an MBTiles file"):
        read(walk(tmp_path, "map.mbtiles"))


def test_a_tile_file_may_have_any_name_and_odd_rows(tmp_path: Path) -> None:
    name = "up & down, 100 % #2?.mbtiles"
    mission = walk(tmp_path, name)
    mbtiles(tmp_path / name, range(14, 17), *mission.frame.to_geodetic(150.0, 150.0)[:2])
    odd = [(99, 1, 1, b"x"), (-1, 0, 0, png()), ("high", 1, 1, png()), (None, None, None, None)]
    with closing(sqlite3.connect(tmp_path / name)) as file:
        file.executemany("insert into tiles values (?, ?, ?, ?)", odd)
        file.executemany(
            "insert into metadata values (?, ?)", [("bounds", None), (None, "x"), ("attribution", None)]
        )
        (one,) = file.execute("select min(rowid) from tiles where zoom_level = 16").fetchone()
        file.execute("update tiles set tile_data = 'text' where rowid = ?", (one,))
        file.commit()
    found = read(mission)
    assert found.credit == "" and {picture.name.split("-")[0] for picture in found.pictures} == {"16"}


def test_a_damaged_tile_is_left_out_of_a_report_and_costs_no_more(tmp_path: Path) -> None:
    mission = walk(tmp_path, "map.mbtiles")
    mbtiles(tmp_path / "map.mbtiles", range(16, 17), *mission.frame.to_geodetic(150.0, 150.0)[:2])
    found = read(mission)
    damaged = replace(found, pictures=(replace(found.pictures[0], data=png()[:40]), *found.pictures[1:]))
    assert len(damaged.inlined()["pictures"]) == len(found.pictures) - 1


def test_vector_tiles_are_refused_with_what_to_do(tmp_path: Path) -> None:
    mission = walk(tmp_path, "map.mbtiles")
    mbtiles(tmp_path / "map.mbtiles", range(16, 17), 47.4, 8.55, format="pbf")
    with pytest.raises(ConfigError, match="export raster tiles"):
        read(mission)


# -- pictures ----------------------------------------------------------------------------------------------------


def world(path: Path, pixel: tuple[float, float], upper_left: tuple[float, float]) -> None:
    """Six lines: x scale, two turns, y scale, and the middle of the first pixel."""
    x, y = upper_left[0] + pixel[0] / 2, upper_left[1] + pixel[1] / 2
    path.write_text("\n".join(f"{value:.10f}" for value in (pixel[0], 0.0, 0.0, pixel[1], x, y)))


@pytest.mark.parametrize(
    "ending, world_ending", [("png", "pgw"), ("jpg", "jgw"), ("tif", "tfw"), ("png", "wld")]
)
def test_a_picture_in_utm_lies_where_its_world_file_says(
    ending: str, world_ending: str, tmp_path: Path
) -> None:
    mission = walk(tmp_path, f"ground.{ending}", "EPSG:32632")
    east, north, zone, _ = utm.from_latlon(*mission.frame.to_geodetic(-20.0, 320.0)[:2])
    assert zone == 32
    Image.new("RGB", (340, 340), (90, 120, 90)).save(tmp_path / f"ground.{ending}")
    world(tmp_path / f"ground.{world_ending}", (1.0, -1.0), (east, north))
    found = read(mission)
    (picture,) = found.pictures
    assert found.covered == 1.0
    nw, ne, sw = picture.corners_m
    assert nw == pytest.approx((-20.0, 320.0), abs=0.01)
    assert ne == pytest.approx((320.0, 320.0), abs=4.0) and sw == pytest.approx((-20.0, -20.0), abs=4.0), (
        "UTM is turned"
    )


def test_degrees_are_told_by_themselves_and_all_else_must_be_named(tmp_path: Path) -> None:
    mission = walk(tmp_path, "ground.png")
    lat, lon, _ = mission.frame.to_geodetic(-10.0, 310.0)
    Image.new("RGB", (400, 400)).save(tmp_path / "ground.png")
    world(tmp_path / "ground.pgw", (1.2e-5, -0.8e-5), (lon, lat))
    assert read(mission).pictures[0].corners_m[0] == pytest.approx((-10.0, 310.0), abs=0.05)
    world(tmp_path / "ground.pgw", (1.0, -1.0), (465_000.0, 5_249_000.0))
    with pytest.raises(ConfigError, match=r"ground.pgw does not say in which coordinates.*background_crs"):
        read(mission)


def test_metres_of_the_field_itself_will_do(tmp_path: Path) -> None:
    mission = walk(tmp_path, "sketch.png", "local")
    Image.new("RGBA", (150, 150), (0, 0, 0, 0)).save(tmp_path / "sketch.png")
    world(tmp_path / "sketch.pgw", (2.0, -2.0), (0.0, 300.0))
    (picture,) = read(mission).pictures
    assert (
        picture.corners_m == ((0.0, 300.0), (300.0, 300.0), (0.0, 0.0)) and picture.media_type == "image/png"
    )


def geotiff(
    path: Path, code: int, scale: float, upper_left: tuple[float, float], *, point: bool = False
) -> None:
    tags = TiffImagePlugin.ImageFileDirectory_v2()
    tags[33550] = (scale, scale, 0.0)
    tags.tagtype[33550] = tags.tagtype[33922] = 12
    tags[33922] = (0.0, 0.0, 0.0, *upper_left, 0.0)
    tags[34735] = (1, 1, 0, 3, 1024, 0, 1, 1, 1025, 0, 1, 2 if point else 1, 3072, 0, 1, code)
    tags.tagtype[34735] = 3
    Image.new("RGB", (400, 400), (90, 120, 90)).save(path, tiffinfo=tags)


@pytest.mark.parametrize("point", [False, True])
def test_a_geotiff_needs_no_other_file(point: bool, tmp_path: Path) -> None:
    mission = walk(tmp_path, "ground.tif")
    east, north, *_ = utm.from_latlon(*mission.frame.to_geodetic(-20.0, 340.0)[:2])
    geotiff(tmp_path / "ground.tif", 32632, 1.0, (float(east), float(north)), point=point)
    nw = read(mission).pictures[0].corners_m[0]
    # Of a raster whose pixels are points the first pixel's middle is told, not its corner.
    assert nw == pytest.approx((-20.5, 340.5) if point else (-20.0, 340.0), abs=0.02)


def test_web_maps_coordinates_are_known() -> None:
    """20037508.34 m is half the equator of web maps (EPSG:3857)."""
    assert to_degrees("EPSG:3857", 20_037_508.342_789, 0.0) == pytest.approx((0.0, 180.0))
    assert to_degrees("EPSG:3857", 0.0, 20_037_508.342_789)[0] == pytest.approx(85.0511287798)


def test_a_large_picture_is_cut_to_the_field(tmp_path: Path) -> None:
    mission = walk(tmp_path, "ground.png", "local")
    Image.new("L", (6000, 6000)).save(tmp_path / "ground.png")
    world(tmp_path / "ground.pgw", (1.0, -1.0), (-3000.0, 3000.0))
    (picture,) = read(mission).pictures
    with Image.open(io.BytesIO(picture.data)) as shown:
        assert shown.size == (390, 390), "the field and 15 % on each side"
    assert picture.corners_m[0] == pytest.approx((-45.0, 345.0))


@pytest.mark.parametrize(
    "name, crs, says",
    [
        ("nothing.png", "", "no such file"),
        ("notes.txt", "", r"expected .mbtiles or a picture"),
        ("bare.png", "", r"nothing says where it is.*\.pgw"),
        ("lambert.tif", "", r"its coordinates are EPSG:2154; expected EPSG:4326"),
        ("broken.png", "local", "cannot be read as a picture"),
        ("far.png", "local", r"a picture of elsewhere, 9 km away"),
        ("odd.png", "local", "expected six numbers"),
    ],
)
def test_what_cannot_be_shown_says_why(name: str, crs: str, says: str, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("x")
    for each in ("bare", "far", "odd"):
        (tmp_path / f"{each}.png").write_bytes(png())
    (tmp_path / "broken.png").write_bytes(png()[:60])
    world(tmp_path / "broken.pgw", (1.0, -1.0), (0.0, 300.0))
    world(tmp_path / "far.pgw", (1.0, -1.0), (9000.0, 300.0))
    (tmp_path / "odd.pgw").write_text("1\n2\nthree")
    geotiff(tmp_path / "lambert.tif", 2154, 1.0, (0.0, 0.0))
    with pytest.raises(ConfigError, match=says):
        read(walk(tmp_path, name, crs))


def test_a_picture_larger_than_can_be_read_says_what_to_make_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, recwarn: pytest.WarningsRecorder
) -> None:
    (tmp_path / "large.png").write_bytes(png())
    world(tmp_path / "large.pgw", (1.0, -1.0), (0.0, 300.0))
    # Pillow warns of what is larger: nobody in the field can act on that.
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 60_000)
    assert read(walk(tmp_path, "large.png", "local")).covered > 0.5 and not recwarn.list
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 30_000)
    module._read.cache_clear()
    with pytest.raises(ConfigError, match="more than 0 million pixels: cut it to the field"):
        read(walk(tmp_path, "large.png", "local"))


def test_a_large_picture_is_read_once_until_it_or_its_world_file_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An editor asks for it at every change of the draft."""
    (tmp_path / "ground.png").write_bytes(png())
    world(tmp_path / "ground.pgw", (1.0, -1.0), (0.0, 300.0))
    mission = walk(tmp_path, "ground.png", "local")
    reads: list[Path] = []
    encoded = module._encoded
    monkeypatch.setattr(module, "_encoded", lambda image: [reads.append(tmp_path), encoded(image)][1])
    assert read(mission) is read(mission) and len(reads) == 1
    world(tmp_path / "ground.pgw", (1.0, -1.0), (10.0, 300.0))
    assert read(mission).pictures[0].corners_m[0] == pytest.approx((10.0, 300.0)) and len(reads) == 2


# -- a mission with one ------------------------------------------------------------------------------------------


def test_check_stops_at_a_map_of_elsewhere_and_a_mission_goes_on_without(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    receiver = {"driver": "lines", "port": "-", "map": "rylr"}
    mission = walk_mission(1)
    text = walk_text(WalkOptions(receiver, "/dev/x", "antenna.toml", (47.3977, 8.5456)))
    text = text.replace("[field]\n", '[field]\nbackground = "map.mbtiles"\n')
    assert parse_mission(text, "walk").field.background == "map.mbtiles"
    (tmp_path / "mission.toml").write_text(text)
    (tmp_path / "antenna.toml").write_text(mission.antenna_text)
    mbtiles(tmp_path / "map.mbtiles", range(12, 18), 52.52, 13.405, bounds="13.3,52.4,13.5,52.6")
    result = CliRunner().invoke(build(), ["check", str(tmp_path / "mission.toml")])
    assert isinstance(result.exception, ConfigError) and "a map of elsewhere" in str(result.exception)
    assert background_or_none(walk(tmp_path, "map.mbtiles")) is None
    assert "the map has no background" in caplog.text


def test_check_says_how_much_of_the_field_is_shown(tmp_path: Path) -> None:
    mission = walk(tmp_path, "half.png", "local")
    (tmp_path / "half.png").write_bytes(png(side=150))
    world(tmp_path / "half.pgw", (1.0, -2.0), (0.0, 300.0))
    assert read(mission).covered == pytest.approx(0.5)


def test_a_recording_finds_the_ground_where_the_mission_was_flown(tmp_path: Path) -> None:
    small_mission(tmp_path, duration_s=2.0)
    (tmp_path / "ground.png").write_bytes(png())
    world(tmp_path / "ground.pgw", (0.1, -0.1), (0.0, 10.0))
    field = 'background = "ground.png"\nbackground_crs = "local"\n'
    path = tmp_path / "mission.toml"
    path.write_text(path.read_text().replace("origin_lat_deg", f"{field}origin_lat_deg", 1))
    (tmp_path / "runs").mkdir()
    log = record(read_mission(path), tmp_path / "runs" / "mission.mcap", 1)
    mission = recorded_mission(open_recording(log))
    assert read(mission).covered == 1.0
    (tmp_path / "runs" / "ground.png").write_bytes(png())  # another of this name lies nearer
    world(tmp_path / "runs" / "ground.pgw", (0.1, -0.1), (0.0, 5.0))
    assert read(recorded_mission(open_recording(log))).covered == 0.5
