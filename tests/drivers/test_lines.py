"""Maps of radios that print: every ready-made one on its documented line, and what makes no sense."""

import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import settings as budget
from hypothesis import strategies as st
from lines_bench import context

from drivers.emulators.printer import STYLES, PrintingRadio
from drivers.lines.mapping import Heard, LineMap, NoReadingError
from drivers.lines.maps import MAPS
from drivers.lines.propose import propose
from drivers.lines.receiver import LONGEST_LINE, LinesOptions, LineSplitter, map_of, open_receiver
from drivers.timebase import DeviceStamps
from fieldkit.engine.association.detections import Associator
from fieldkit.errors import ConfigError
from fieldkit.messages import Pose, RssReading

DOCUMENTED = {
    "json": Heard(-71.5, "tag-7", 15),
    "esp32-wifi": Heard(-58.0, "field-beacon", 6),
    "esp32-ble": Heard(-72.0, "5c:31:3e:a1:b2:c3"),
    "meshtastic": Heard(-93.0, "!7efeee00", None, None, 447103),
    "meshtastic-mqtt": Heard(-97.0, "2130636288", None, None, 452664778),
    "rylr": Heard(-99.0, "50"),
    "rak": Heard(-84.0),
    "lora-e5": Heard(-106.0),
    "rtl_433": Heard(-12.144, "11524"),
    "rtl_power": Heard(-18.44),
    "kismet": Heard(-61.0, "5C:31:3E:A1:B2:C3", 6),
    "ctt": Heard(-83.0, "4C34074B", None, 1614607392.312),
}


# -- maps ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", MAPS)
def test_a_ready_made_map_reads_the_line_its_documents_show(name: str) -> None:
    MAPS[name].check(name)
    assert MAPS[name].about
    assert MAPS[name].read(MAPS[name].example) == DOCUMENTED[name]


@pytest.mark.parametrize("name", MAPS)
def test_a_documented_line_gets_its_own_map_proposed(name: str) -> None:
    found = propose(["booting", MAPS[name].example, MAPS[name].example])
    assert found is not None and found.read == 2
    assert found.map.read(MAPS[name].example).rss_dbm == DOCUMENTED[name].rss_dbm  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("line", "rss_dbm"),
    [
        ("RSSI: -70", -70.0),
        ("node 3 rssi=-70.5dBm snr=9", -70.5),
        ("level 34", -34.0),
        ('{"radio": {"signal": -61, "mac": "a"}}', -61.0),
        ('{"my \\"rssi\\"": -62}', -62.0),
    ],
)
def test_a_radio_in_words_of_its_own_gets_a_map_proposed(line: str, rss_dbm: float) -> None:
    found = propose(["booting", line, line])
    assert found is not None and found.read == 2
    for text in (f"x = {{ {found.toml()} }}", "[x]\n" + "\n".join(found.keys())):
        options = LinesOptions("-", **tomllib.loads(text)["x"])
        assert map_of(options, "lines").read(line) == Heard(rss_dbm, (found.map.source and "a") or None)


@pytest.mark.parametrize("name", STYLES)
def test_what_an_emulated_radio_prints_is_read_by_the_map_of_its_name(name: str) -> None:
    line = (PrintingRadio(lambda: 0, name).hear(-77.0, 0xBEEF, b"") or b"").decode()
    heard = MAPS[name].read(line.strip())
    assert heard is not None and heard.rss_dbm == -77.0


def test_an_emulated_stations_clock_goes() -> None:
    radio = PrintingRadio(iter([1_614_607_392_312_000, 1_614_607_395_712_000]).__next__, "ctt")
    first, second = [MAPS["ctt"].read((radio.hear(-77.0, 1, b"") or b"").decode().strip()) for _ in range(2)]
    assert first is not None and second is not None
    assert (first.time_s, second.time_s) == (1614607392.312, 1614607395.712)


def test_a_clock_that_stands_still_says_nothing_of_when_a_line_was_heard() -> None:
    stamps, second_ns = DeviceStamps(), 1_000_000_000
    arrivals = [1_700_000_000 * second_ns + s * second_ns for s in range(0, 40, 2)]
    assert [stamps.of(1_614_607_392_312_000_000, t) for t in arrivals] == arrivals
    # Two that were held back by the link belong together all the same, and a clock that goes again counts again.
    assert (
        stamps.of(1_614_607_500_000_000_000, arrivals[-1] + 10 * second_ns) == arrivals[-1] + 10 * second_ns
    )
    late_ns = arrivals[-1] + 12 * second_ns
    assert stamps.of(1_614_607_501_000_000_000, late_ns) == late_ns - second_ns


@pytest.mark.parametrize(
    ("line_map", "line", "says"),
    [
        (LineMap("json", rss="a.b"), "[1]", "not an object"),
        (LineMap("json", rss="a.b"), "{", "is not JSON"),
        (LineMap("json", rss="a.b"), '{"a": {"c": -70}}', "no number at 'a.b'"),
        (LineMap("json"), '{"rss": true}', "no number"),
        (LineMap("json"), '{"rss": NaN}', "no number"),
        (LineMap("json"), '{"rss": 71}', 'reads 71 dBm, which no radio receives: is the unit "-dBm"'),
        (LineMap("json", unit="-dBm"), '{"rss": -71}', 'is the unit "dBm"?'),
        (LineMap("json", unit="relative dB"), '{"rss": 71.5}', "shift the scale, as with offset_db = -100"),
        (LineMap("json", unit="relative dB"), '{"rss": -1e300}', "shift the scale, as with offset_db = 100"),
        (LineMap("regex", pattern="rssi (?P<rss>.*)"), "hello", "does not match"),
        (LineMap("regex", pattern="rssi (?P<rss>.*)"), "rssi loud", "no number"),
    ],
)
def test_a_line_that_is_no_reading_says_why(line_map: LineMap, line: str, says: str) -> None:
    with pytest.raises(NoReadingError) as refused:
        line_map.read(line)
    assert says in str(refused.value)


def test_units_signs_and_commas_are_stated_once() -> None:
    assert LineMap("json", unit="-dBm").read('{"rss": 71}') == Heard(-71.0)
    assert LineMap("json", unit="relative dB", offset_db=-100.0).read('{"rss": 71.5}') == Heard(-28.5)
    several = LineMap("csv", columns=("t", "rss*"), unit="-dBm")
    assert several.read("1, 80, 60, 90") == Heard(-60.0), "the strongest, whatever its sign"
    assert LineMap("regex", pattern="(?P<rss>-[0-9,]+)").read("at -70,5 dBm") == Heard(-70.5)
    assert LineMap("json", heard="ok").read('{"ok": false}') is None
    assert LineMap("json", time="t", time_unit="ms").read('{"rss": -70, "t": 1500}') == Heard(
        -70.0, time_s=1.5
    )


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({}, "expected 'map'"),
        ({"map": "esp"}, "option 'map': expected one of json, esp32-wifi"),
        ({"format": "xml"}, "option 'format': expected json, regex, csv"),
        ({"format": "regex", "pattern": "("}, "not a regular expression"),
        ({"format": "regex", "pattern": "(?P<power>x)"}, "named groups power; rss is missing"),
        ({"format": "csv", "columns": ["a", "b"]}, "option 'columns' names a, b; rss is missing"),
        ({"map": "json", "unit": "mW"}, "option 'unit': expected dBm"),
        ({"map": "json", "time_unit": "h"}, "option 'time_unit': expected s, ms, us, iso"),
        ({"map": "json", "heartbeat_s": 0}, "option 'heartbeat_s': expected above 0"),
        ({"map": "json", "speed": 1}, "unknown option 'speed'"),
    ],
)
def test_a_map_that_makes_no_sense_is_refused_before_anything_is_opened(
    options: dict[str, Any], says: str
) -> None:
    with pytest.raises(ConfigError) as refused:
        open_receiver("ada", {"port": "/dev/null", **options}, context())
    assert says in str(refused.value)


def test_the_map_of_ones_own_that_the_docs_show_reads_what_they_say() -> None:
    text = Path("docs/lines.md").read_text(encoding="utf-8")
    said = tomllib.loads(text.split("```toml")[1].split("```")[0])
    own = LinesOptions(**said)
    line_map = map_of(own, "docs")
    assert line_map.read("CH=37;ID=A7;S=79;ok") == Heard(-79.0, "A7", 37)
    assert line_map.read("CH=37;idle") is None and own.heartbeat_s == 5


@pytest.mark.parametrize("tail", [r"(a|a)*$", r"(a|aa)+$"])
def test_a_pattern_that_thinks_for_ever_is_given_up_and_said(tail: str) -> None:
    line_map = LineMap("regex", pattern=r"^(?P<rss>-\d+)" + tail)
    line_map.check("here")
    assert line_map.read("-70aaaaaaaaaaaaaaaaaaaa") == Heard(-70.0)
    with pytest.raises(NoReadingError, match=r"takes the pattern over 0\.05 s"):
        line_map.read("-70" + "a" * 60 + "!")


@budget(max_examples=200, deadline=None)
@given(st.text(max_size=200), st.sampled_from(sorted(MAPS)))
def test_any_line_is_a_reading_or_no_reading(line: str, name: str) -> None:
    try:
        heard = MAPS[name].read(line)
    except NoReadingError:
        return
    assert heard is None or heard.rss_dbm == heard.rss_dbm


@budget(max_examples=100, deadline=None)
@given(
    st.lists(st.text(st.characters(codec="utf-8", exclude_characters="\n\r\x00")), max_size=20),
    st.integers(1, 50),
)
def test_lines_come_out_whole_however_they_are_cut(lines: list[str], cut: int) -> None:
    data = "".join(line + "\r\n" for line in lines).encode()
    split, out = LineSplitter(), list[str]()
    for at in range(0, len(data), cut):
        out += split.feed(data[at : at + cut])
    whole = [line.strip("\ufeff\r \t\x00") for line in lines]
    assert out == [line for line in whole if line]


def test_a_line_without_end_is_dropped_and_takes_no_memory() -> None:
    split = LineSplitter()
    for _ in range(100):
        assert split.feed(b"x" * 10_000) == []
    assert len(split._rest) <= LONGEST_LINE
    assert split.feed(b"tail\nnext\n") == ["next"]
    assert split.dropped == 1


def test_a_device_may_end_its_lines_with_carriage_returns_alone() -> None:
    split, out = LineSplitter(), list[str]()
    for data in (b"RSSI -70\rRSSI -7", b"1\rRSSI -72", b"\rRSSI -73\rRSSI -74"):
        out += split.feed(data)
    assert out == [f"RSSI -{number}" for number in (70, 71, 72, 73)]
    usual = LineSplitter()
    assert usual.feed(b"a\n") + usual.feed(b"1\r2\r3\r4\n") == ["a", "1\r2\r3\r4"]


def test_what_a_map_reads_a_mission_takes() -> None:
    """A reading that is left out later would pass for silence."""
    for rss in ("-151", "-150", "0", "1"):
        try:
            heard = MAPS["json"].read(f'{{"rss_dbm": {rss}}}')
        except NoReadingError:
            heard = None
        associator = Associator(("ada",))
        associator.pose(Pose(0, "ada", 1.0, 1.0))
        associator.reading(RssReading(0, "ada", float(rss)))
        assert (heard is not None) == bool(associator._open), rss


def test_a_byte_order_mark_before_a_line_is_no_part_of_it() -> None:
    """Windows puts one at the beginning of a file, and some senders into each datagram."""
    line = '{"rss_dbm": -70}'
    assert LineSplitter().feed(b"".join(f"\ufeff{line}\r\n".encode() for _ in range(2))) == [line, line]
