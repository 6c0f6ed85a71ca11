"""The camera on rendered films: what it finds, what it leaves out, and what it does when there are no pictures."""

import asyncio
import json
import math
import subprocess
import sys

import numpy as np
import pytest
from benches import FRAME, until
from typer.testing import CliRunner

from drivers.camera.benchmark import errors, marker_scene, options_for, patch_scene
from drivers.camera.cli import app
from drivers.camera.file import read_view
from drivers.camera.seen import Body, Judge, Seen, crossing
from drivers.camera.source import CameraOptions, make_task, open_camera
from drivers.camera.view import Lens, fit_view
from drivers.emulators.camera import (
    Eye,
    PictureServer,
    Scene,
    Shown,
    circle,
    still,
    write_calibration,
    write_film,
)
from fieldkit.clock import RealClock, ScaledClock
from fieldkit.errors import CalibrationRefused, ConfigError, DeviceError
from fieldkit.ports import DriverContext
from fieldkit.testing import nothing_left

cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed: pip install spog-fieldkit[camera]")

FIELD = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0], [5.0, 0.0], [10.0, 5.0]])
AROUND = DriverContext(RealClock(), FRAME)


def pixels_of(field_m, eye=None):
    return (eye or Eye()).project(np.column_stack([field_m, np.zeros(len(field_m))]))


# The view


def test_a_pinhole_camera_is_fitted_without_residual():
    view = fit_view(pixels_of(FIELD), FIELD)
    assert view.rms_m < 1e-6
    inside = np.array([[2.5, 7.5], [9.0, 1.0]])
    assert view.to_field(pixels_of(inside)) == pytest.approx(inside, abs=1e-6)
    assert view.to_picture(inside) == pytest.approx(pixels_of(inside), abs=1e-4)


def test_what_stands_above_the_ground_is_put_where_it_stands():
    eye = Eye()
    view = fit_view(pixels_of(FIELD), FIELD, camera_m=eye.place_m)
    mast = np.array([[2.0, 9.0, 0.5]])
    assert np.hypot(*(view.to_field(eye.project(mast))[0] - [2.0, 9.0])) > 0.3
    assert view.to_field(eye.project(mast), 0.5)[0] == pytest.approx([2.0, 9.0], abs=1e-6)


def test_a_bent_lens_is_straightened():
    lens = Lens(610.0, 610.0, 639.5, 359.5, (-0.15, 0.03, 0.0, 0.0, 0.0))
    straight = pixels_of(FIELD)
    rays = np.column_stack([(straight - [lens.cx, lens.cy]) / 610.0, np.ones(len(straight))])
    bent = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), lens.matrix, np.array(lens.distortion))[0][:, 0]
    assert np.abs(bent - straight).max() > 5.0
    assert fit_view(bent, FIELD).rms_m > 0.02
    view = fit_view(bent, FIELD, lens=lens)
    assert view.rms_m < 1e-3
    assert view.to_picture(FIELD) == pytest.approx(bent, abs=0.05)


@pytest.mark.parametrize(
    ("field_m", "words"),
    [
        ([[0, 0], [1, 1], [2, 2], [3, 3]], "one line"),
        ([[0, 0], [1, 1], [2, 2], [3, 0]], "one line"),
        ([[0, 0], [1, 0.001], [2, 0], [3, 0.001], [4, 0]], "one line"),
        ([[0, 0], [1, 0], [0, 1]], "at least 4"),
        ([[0, 0], [1, 0], [1, 1], [0, math.nan]], "not a number"),
        ([[0, 0], [10, 0], [0, 10], [10, 10]], "contradict"),
    ],
)
def test_points_that_cannot_carry_a_plane_are_refused(field_m, words):
    pixels = pixels_of(FIELD)[: len(field_m)] if len(field_m) < 5 else pixels_of(np.array(field_m))
    with pytest.raises(CalibrationRefused, match=words):
        fit_view(pixels, np.array(field_m, dtype=float))


def test_points_on_one_line_in_the_picture_are_refused():
    pixels = np.array([[0.0, 0.0], [100, 100], [200, 200], [300, 300]])
    with pytest.raises(CalibrationRefused, match="in the picture"):
        fit_view(pixels, FIELD[:4])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("schema = 2", "schema"),
        ("schema = 1", "points"),
        ("schema = 1\npoints = [[1, 2, 3]]", r"points\[0\]"),
        ("schema = 1\nponts = []", "ponts"),
        ("schema = 1\ncamera_m = [1, 2, -3]\npoints = [[1, 2, 3, 4]]", "height"),
        ("schema = 1\npoints = [[1, 2, 3, 4]]\nlens = { fx = 1.0 }", "lens"),
        ("schema = ", "TOML"),
    ],
)
def test_a_calibration_file_that_is_wrong_is_named(tmp_path, text, words):
    path = tmp_path / "camera.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=words) as caught:
        read_view(path)
    assert "camera.toml" in str(caught.value)


# Judging what was seen


def seen_at(robot, east, north, heading_deg=0.0, side=0.4, view=None):
    ahead = np.array([math.sin(math.radians(heading_deg)), math.cos(math.radians(heading_deg))]) * side / 2
    right = np.array([ahead[1], -ahead[0]])
    place = np.array([east, north])
    corners = np.array(
        [place + ahead - right, place + ahead + right, place - ahead + right, place - ahead - right]
    )
    points = pixels_of(corners)
    return Seen(robot, (points[0] + points[1]) / 2, (points[2] + points[3]) / 2, points)


@pytest.fixture
def judge():
    return Judge(fit_view(pixels_of(FIELD), FIELD), {"ada": Body(0.4), "bob": Body(0.4)}, max_speed_m_s=1.0)


def test_a_marker_gives_place_and_heading(judge):
    (fix,) = judge.judge([seen_at("ada", 3.0, 4.0, 120.0)], 0.0)
    assert (fix.east_m, fix.north_m) == pytest.approx((3.0, 4.0), abs=1e-3)
    assert fix.heading_deg == pytest.approx(120.0, abs=1.5) and 0.0 < fix.sigma_m < 0.05


def test_a_marker_seen_twice_is_doubtful_and_the_others_are_not(judge):
    fixes = judge.judge([seen_at("ada", 3, 4), seen_at("ada", 7, 7), seen_at("bob", 1, 1)], 0.0)
    assert [fix.robot for fix in fixes] == ["bob"] and judge.inconsistent == {"ada": "seen twice"}


def test_a_mark_of_the_wrong_size_is_doubtful(judge):
    assert judge.judge([seen_at("ada", 3, 4, side=0.8)], 0.0) == []
    assert "expected" in judge.inconsistent["ada"]


def test_a_jump_is_believed_once_it_stays(judge):
    assert judge.judge([seen_at("ada", 1, 1)], 0.0)
    believed = [bool(judge.judge([seen_at("ada", 9, 9)], 0.1 * k)) for k in range(1, 5)]
    assert believed == [False, False, True, True]


def test_diagonals_cross_in_the_middle_of_a_square_seen_aslant():
    corners = pixels_of(np.array([[0.0, 10.0], [10.0, 10.0], [10.0, 0.0], [0.0, 0.0]]))
    assert crossing(corners) == pytest.approx(pixels_of(np.array([[5.0, 5.0]]))[0], abs=1e-6)


# Rendered films


@pytest.mark.parametrize("make", [marker_scene, patch_scene])
def test_robots_are_found_where_they_are(tmp_path, make):
    """The papers' figures: 0.1 m and 3.5 degrees, in noise, blur, shadow and with something in the way."""
    scene = make()
    times = write_film(scene, tmp_path / "film.avi", 4.0, 8.0)
    write_calibration(scene, tmp_path / "camera.toml")
    options = options_for(scene, str(tmp_path / "film.avi"), tmp_path / "camera.toml")
    position_m, heading_deg, found, _ = errors(scene, options, times)
    assert max(position_m) < 0.1
    assert np.percentile(heading_deg, 99) < 3.5
    assert found > 0.6 * len(times) * len(scene.robots)


def one_film(tmp_path, robots, duration_s=0.5, **scene_options):
    scene = Scene(robots, shadows=False, **scene_options)
    times = write_film(scene, tmp_path / "film.avi", duration_s)
    write_calibration(scene, tmp_path / "camera.toml", click_px=0.0)
    return scene, options_for(scene, str(tmp_path / "film.avi"), tmp_path / "camera.toml"), times


def test_a_hidden_robot_is_absent_and_the_others_are_not(tmp_path):
    robots = {
        "ada": Shown(still(3.0, 3.0, 10.0), marker=3),
        "bob": Shown(still(7.0, 7.0, 10.0), marker=7),
    }
    hidden = still(3.0, 3.0, 0.0)
    scene, options, times = one_film(tmp_path, robots, hiding_m=hidden)
    task = make_task(CameraOptions(**options))
    from drivers.camera.capture import Finder

    finder = Finder(task)
    assert {fix.robot for t_s in times for fix in finder.fixes(scene.picture(t_s), t_s)} == {"bob"}


def test_two_of_one_marker_in_a_picture_give_no_pose(tmp_path):
    from drivers.camera.capture import Finder

    robots = {"ada": Shown(still(3.0, 3.0, 10.0), marker=3)}
    scene, options, _ = one_film(tmp_path, robots)
    scene.robots["twin"] = Shown(still(7.0, 7.0, 10.0), marker=3)
    finder = Finder(make_task(CameraOptions(**options)))
    assert finder.fixes(scene.picture(0.0), 0.0) == [] and finder.judge.inconsistent == {"ada": "seen twice"}


@pytest.mark.parametrize("family", ["aruco-4x4", "aruco-5x5", "apriltag-16h5", "apriltag-36h11"])
def test_every_family_has_its_front_where_it_is_printed(tmp_path, family):
    from drivers.camera.capture import Finder

    robots = {"ada": Shown(still(5.0, 3.0, 60.0), marker=3, mark_m=0.8)}
    scene, options, _ = one_film(tmp_path, robots, family=family)
    (fix,) = Finder(make_task(CameraOptions(**options, family=family))).fixes(scene.picture(0.0), 0.0)
    assert fix.heading_deg == pytest.approx(60.0, abs=2.0)
    assert (fix.east_m, fix.north_m) == pytest.approx((5.0, 3.0), abs=0.03)


# The source


async def test_a_film_gives_its_poses_and_ends(tmp_path):
    robots = {"ada": Shown(circle(5.0, 5.0, 2.0), marker=3)}
    scene, options, times = one_film(tmp_path, robots, 1.0)
    async with nothing_left(), open_camera({**options, "every_picture": True}, AROUND) as source:
        poses = [pose async for pose in source.poses()]
    assert len(poses) == len(times)
    assert [round((pose.t_ns - poses[0].t_ns) * 1e-9 * 16) for pose in poses] == list(range(len(times)))
    for pose, t_s in zip(poses, times, strict=True):
        east, north, _ = scene.robots["ada"].path(t_s)
        assert math.hypot(pose.east_m - east, pose.north_m - north) < 0.05
    assert {pose.origin for pose in poses} == {"camera"}


async def test_a_scaled_clock_stamps_pictures_in_mission_time(tmp_path):
    _, options, _ = one_film(tmp_path, {"ada": Shown(still(5.0, 5.0, 0.0), marker=3)}, 1.0)
    clock = ScaledClock(10.0)
    async with open_camera(options, DriverContext(clock, FRAME)) as source:
        poses = [pose async for pose in source.poses()]
    assert (poses[-1].t_ns - poses[0].t_ns) * 1e-9 > 5.0


async def test_a_network_camera_whose_process_is_killed_is_seen_again(tmp_path):
    robots = {"ada": Shown(still(5.0, 5.0, 30.0), marker=3)}
    scene, options, _ = one_film(tmp_path, robots, noise=1.0)
    poses = []
    async with nothing_left(), PictureServer(scene.picture, 8.0) as server:
        async with open_camera({**options, "source": server.url}, AROUND) as source:
            task = asyncio.create_task(_collect(source, poses))
            await until(lambda: len(poses) >= 3)
            source.kill_process()
            await until(lambda: source.restarts == 1)
            before = len(poses)
            await until(lambda: len(poses) > before + 2, 30.0)
        await task
    assert poses[-1].heading_deg == pytest.approx(30.0, abs=3.0)


async def test_a_network_camera_that_stalls_or_goes_away_is_taken_back(tmp_path, monkeypatch):
    monkeypatch.setattr("drivers.camera.source.SILENT_S", 1.0)
    scene, options, _ = one_film(tmp_path, {"ada": Shown(still(5.0, 5.0, 30.0), marker=3)}, noise=1.0)
    poses = []
    async with nothing_left(), PictureServer(scene.picture, 8.0) as server:
        async with open_camera({**options, "source": server.url}, AROUND) as source:
            task = asyncio.create_task(_collect(source, poses))
            await until(lambda: len(poses) >= 3)
            server.stalled = True
            await until(lambda: source.restarts >= 1, 60.0)
            await server.unplug()
            server.stalled = False
            await server.plug()
            before = len(poses)
            await until(lambda: len(poses) > before + 2, 60.0)
        await task


async def test_damaged_pictures_cost_themselves(tmp_path):
    scene, options, _ = one_film(tmp_path, {"ada": Shown(still(5.0, 5.0, 30.0), marker=3)}, noise=1.0)
    poses = []
    async with PictureServer(scene.picture, 8.0) as server:
        async with open_camera({**options, "source": server.url}, AROUND) as source:
            task = asyncio.create_task(_collect(source, poses))
            await until(lambda: len(poses) >= 3)
            server.rewrite = lambda data: data[:200]
            await asyncio.sleep(0.5)
            server.rewrite = None
            before = len(poses)
            await until(lambda: len(poses) > before + 2, 30.0)
        await task
    assert all(math.hypot(pose.east_m - 5.0, pose.north_m - 5.0) < 0.1 for pose in poses)


async def _collect(source, poses):
    async for pose in source.poses():
        poses.append(pose)


@pytest.mark.parametrize(
    ("content", "words"),
    [(None, "no such file"), (b"this is no film at all", "cannot be opened|no pictures")],
)
async def test_a_source_without_pictures_does_not_open(tmp_path, content, words):
    _, options, _ = one_film(tmp_path, {"ada": Shown(still(5.0, 5.0, 0.0), marker=3)})
    path = tmp_path / "other.avi"
    if content is not None:
        path.write_bytes(content)
    async with nothing_left():
        with pytest.raises(DeviceError, match=words):
            async with open_camera({**options, "source": str(path)}, AROUND):
                pass


async def test_a_network_camera_that_is_not_there_does_not_open(tmp_path):
    _, options, _ = one_film(tmp_path, {"ada": Shown(still(5.0, 5.0, 0.0), marker=3)})
    with pytest.raises(DeviceError, match="cannot be opened"):
        async with open_camera({**options, "source": "rtsp://127.0.0.1:9/1"}, AROUND):
            pass


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"robots": {}}, "expected a robot"),
        ({"robots": {"ada": {"marker": 3}, "bob": {"marker": 3}}}, "already"),
        ({"robots": {"ada": {"front": "red"}}}, "front and rear"),
        ({"robots": {"ada": {"marker": 3, "size": 2}}}, "size"),
        ({"family": "qr"}, "family"),
        ({"sauce": "x"}, "sauce"),
        ({"calibration": "nowhere.toml"}, "no such file"),
    ],
)
def test_impossible_options_are_named(tmp_path, changes, words):
    _, options, _ = one_film(tmp_path, {"ada": Shown(still(5.0, 5.0, 0.0), marker=3)}, 0.1)
    with pytest.raises(ConfigError, match=words):
        open_camera({**options, **changes}, AROUND)


# The commands


def test_calibrate_shows_the_grid_and_the_residual(tmp_path):
    scene, _, _ = one_film(tmp_path, {"ada": Shown(still(5.0, 5.0, 0.0), marker=3)}, 0.2)
    write_calibration(scene, tmp_path / "camera.toml", click_px=2.0)
    arguments = ["calibrate", str(tmp_path / "film.avi"), str(tmp_path / "camera.toml")]
    result = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path / "grid.png"), "--json"])
    told = json.loads(result.stdout)
    assert told["points"] == 8 and 0.5 < told["rms_cm"] < 10.0 and len(told["residual_cm"]) == 8
    drawn = cv2.imread(str(tmp_path / "grid.png"))
    x, y = pixels_of(np.array([[4.0, 6.5]]))[0].round().astype(int)
    near = drawn[y - 4 : y + 5, x - 4 : x + 5].astype(int)
    assert (near[:, :, 1] - near[:, :, 2]).max() > 60, "no green grid line where one belongs"


def test_look_tells_where_robots_are(tmp_path):
    one_film(tmp_path, {"ada": Shown(still(5.0, 3.0, 45.0), marker=3)}, 0.2)
    arguments = ["look", str(tmp_path / "film.avi"), str(tmp_path / "camera.toml"), "--marker", "ada=3"]
    arguments += ["--marker", "bob=7", "--out", str(tmp_path / "look.png")]
    result = CliRunner().invoke(app, arguments)
    assert "ada: 5.0" in result.stdout and "bob: not seen" in result.stdout
    assert (tmp_path / "look.png").exists()


def test_importing_the_camera_does_not_import_opencv():
    modules = "drivers.camera.source, drivers.camera.cli, drivers.emulators.camera"
    code = f"import sys, {modules}; print('cv2' in sys.modules)"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.strip() == "False"
