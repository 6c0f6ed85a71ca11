"""The mission editor without a browser: a file as a form and back, what is wrong with it, and who may write it."""

import json
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from fieldkit.cli import build
from fieldkit.errors import ConfigError
from mission.core.mission_file import read_mission
from mission.core.template import mission_text
from mission.lab.synthetic import small_mission
from mission.maps.background import PICTURES, TILES
from mission.page.server import Page
from mission.plan.desk import Desk
from mission.plan.draft import form_of, with_form
from mission.plan.judge import judge
from mission.plan.serve import plan

TEXT = mission_text()
ROBOT = {
    "name": "scout",
    "receiver": {"driver": "xbee", "port": "/dev/ttyUSB9"},
    "vehicle": {"driver": "mavlink", "address": "udpin:0.0.0.0:14550", "system_id": 9},
    "altitude_m": None,
}


def test_a_form_that_says_nothing_new_changes_no_byte() -> None:
    assert with_form(TEXT, form_of(TEXT)) == TEXT


def test_what_the_form_changes_is_changed_and_comments_stay() -> None:
    form = form_of(TEXT)
    form["field"] |= {"size_east_m": 31.5, "fence": [[1, 1], [20, 1], [20, 9.5]]}
    form["robots"] = [form["robots"][0], ROBOT]
    form["teams"] = [["r1", "scout"]]
    text = with_form(TEXT, form)
    assert form_of(text) == form
    lost = set(TEXT.splitlines()) - set(text.splitlines())
    assert all(
        "#" not in line for line in lost if not line.startswith(("size_east_m", "receiver", "vehicle"))
    )
    assert tomllib.loads(text)["robot"][0] == tomllib.loads(TEXT)["robot"][0]


def test_what_the_form_does_not_know_stays(tmp_path: Path) -> None:
    small_mission(tmp_path)
    text = (tmp_path / "mission.toml").read_text()
    text = text.replace("\n[[robot]]\n", "\n[[robot]]\nthreshold_dbm = -93.0\n", 1)
    form = form_of(text)
    form["robots"][0] |= {"name": "renamed", "was": form["robots"][0]["name"]}
    changed = tomllib.loads(with_form(text, form))
    assert changed["robot"][0]["threshold_dbm"] == -93.0 and changed["robot"][0]["name"] == "renamed"
    assert changed["engine"] == tomllib.loads(text)["engine"]


@given(
    names=st.lists(st.text(min_size=1, max_size=12), min_size=1, max_size=6, unique=True),
    size_m=st.floats(1.0, 5000.0),
    port=st.text(max_size=20),
    top=st.text(max_size=40),
)
def test_any_form_comes_back_as_it_went(names: list[str], size_m: float, port: str, top: str) -> None:
    form = form_of(TEXT)
    form["top"]["name"] = top
    form["field"]["size_north_m"] = size_m
    receiver = {"driver": "xbee"} | ({"port": port} if port else {})
    form["robots"] = [ROBOT | {"name": name, "receiver": receiver} for name in names]
    form["teams"] = [names[k : k + 2] for k in range(0, len(names), 2)]
    assert form_of(with_form(TEXT, form)) == form


@pytest.mark.parametrize("form", [{"field": 3, "robots": "x"}, {"robots": [1, None]}, {"teams": 4}, {}])
def test_a_form_of_another_kind_breaks_nothing(form: dict[str, Any]) -> None:
    assert tomllib.loads(with_form(TEXT, form))["field"] == tomllib.loads(TEXT)["field"]


def test_remarks_name_the_key_and_are_those_of_check(tmp_path: Path) -> None:
    small_mission(tmp_path)
    path = tmp_path / "mission.toml"
    text = path.read_text()
    assert not [each for each in judge(text, path) if each.level == "red"]
    (wrong,) = [
        each for each in judge(text.replace("cell_m = ", "cell_m = -", 1), path) if each.level == "red"
    ]
    assert wrong.key == "field.cell_m" and "got -" in wrong.text
    (absent,) = judge(text.replace("antenna.toml", "nowhere.toml"), path)
    assert absent.level == "red" and "nowhere.toml" in absent.text
    form = form_of(text)
    form["robots"][0]["receiver"] = {"driver": "xbee"}
    (driver,) = [each for each in judge(with_form(text, form), path) if each.level == "red"]
    assert driver.key == f"robot {form['robots'][0]['name']}: receiver" and "port" in driver.text


def test_it_is_written_when_asked_and_only_over_what_was_read(tmp_path: Path) -> None:
    path = tmp_path / "mission.toml"
    desk = Desk(path)
    form = desk.state()["form"]
    assert desk.state()["new"] and not path.exists()
    form["top"]["name"] = "north meadow"
    desk.change(form)
    assert not path.exists()
    desk.store()
    assert tomllib.loads(path.read_text())["name"] == "north meadow" and desk.state()["stored"]
    path.write_text(path.read_text() + "# by hand\n")
    form["top"]["name"] = "another"
    desk.change(form)
    with pytest.raises(ConfigError, match="changed by somebody else"):
        desk.store()
    assert path.read_text().endswith("# by hand\n")


def test_vehicles_that_were_heard_stand_in_the_drafts_own_field(tmp_path: Path) -> None:
    desk = Desk(tmp_path / "mission.toml")
    heard: Any = [
        {"system_id": 3, "place_deg": [51.001, 7.0]},
        {"system_id": 4, "place_deg": None},
    ]
    desk.hear(heard)
    form = desk.state()["form"]
    form["field"] |= {"origin_lat_deg": 51.0, "origin_lon_deg": 7.0}
    desk.change(form)
    (standing,) = desk.state()["standing"]
    # 0.001 degrees of latitude at 51 degrees north are 111.248 m on WGS-84.
    assert standing["name"] == "system 3" and standing["place"] == pytest.approx((0.0, 111.248), abs=0.002)
    form["field"]["origin_lat_deg"] = 1000.0
    desk.change(form)
    assert desk.state()["standing"] == []


def test_a_file_that_is_no_toml_is_refused_and_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "mission.toml"
    path.write_text("[field\n")
    with pytest.raises(ConfigError, match="not valid TOML"):
        Desk(path)
    assert path.read_text() == "[field\n"


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Page]:
    small_mission(tmp_path)
    with plan(tmp_path / "mission.toml") as page:
        yield page


def asked(page: Page, path: str, token: str | None = None, body: object = None, **headers: str) -> Any:
    given = {"authorization": f"Bearer {page.token if token is None else token}", **headers}
    data = None if body is None else json.dumps(body).encode()
    request = Request(f"{page.address}plan/{path}", data, given, method="GET" if body is None else "POST")
    with urlopen(request, timeout=30) as answer:
        return json.loads(answer.read())


def status(page: Page, *given: Any, **more: Any) -> int:
    with pytest.raises(HTTPError) as error:
        asked(page, *given, **more)
    return error.value.code


def test_only_who_has_the_token_reads_or_writes_and_no_other_page(page: Page, tmp_path: Path) -> None:
    before = (tmp_path / "mission.toml").read_text()
    assert asked(page, "state")["form"]["robots"]
    assert status(page, "state", "") == status(page, "state", "wrong") == 403
    assert status(page, "store", "wrong", {}) == 403
    assert status(page, "store", body={}, origin="http://evil.example") == 403
    assert status(page, "state", host="evil.example") == 421
    assert status(page, "change", body=[1]) == 400
    assert status(page, "heard?address=--help") == 400
    assert (tmp_path / "mission.toml").read_text() == before


def test_a_change_is_judged_and_stored_over_the_wire(page: Page, tmp_path: Path) -> None:
    form = asked(page, "state")["form"]
    form["field"]["size_east_m"] = -4
    assert [each["key"] for each in asked(page, "change", body=form)["remarks"]] == ["field.size_east_m"]
    form["field"]["size_east_m"] = 12.5
    state = asked(page, "change", body=form)
    assert not state["stored"] and status(page, "preflight", body={}) == 400
    assert asked(page, "store", body={})["stored"]
    assert read_mission(tmp_path / "mission.toml").file.field.size_east_m == 12.5


@pytest.mark.parametrize(("name", "says"), [("new/mission.toml", True), ("mission.toml", False)])
def test_a_folder_that_is_yet_to_be_made_is_announced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, says: bool
) -> None:
    def ctrl_c(_: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("fieldkit.clock.wall_sleep", ctrl_c)
    done = CliRunner().invoke(build(), ["plan", str(tmp_path / name), "--no-open", "--page-port", "0"])
    assert done.exit_code == 0, done.output
    assert (f"there is no folder {tmp_path / 'new'} yet: Store makes it" in done.output) == says, done.output


def test_every_kind_of_background_is_offered(tmp_path: Path) -> None:
    for suffix in (*PICTURES, TILES, ".gif"):
        (tmp_path / f"map{suffix}").touch()
    offered = Desk(tmp_path / "mission.toml").choices()["pictures"]
    assert {"map.webp", "map.png", "map.mbtiles"} <= set(offered)
    assert offered == sorted(f"map{suffix}" for suffix in (*PICTURES, TILES))
