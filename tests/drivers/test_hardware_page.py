"""A vehicle set up by docs/hardware.md to the letter is green."""

import re
from pathlib import Path

from drivers.mavlink import failsafes
from drivers.mavlink.modes import COPTER, PX4, ROVER, Firmware
from fieldkit.ports import Demands

PAGE = (Path(__file__).parents[2] / "docs" / "hardware.md").read_text()
WORDS = {
    "the mission's max_speed_m_s": 1.0,
    "100 times the mission's max_speed_m_s": 100.0,
    "3.5 V a lithium cell": 10.5,
    "3.5 V a cell": 10.5,
    "without 16": 0.0,
    "one for each copter": 1500.0,
    "the mission's speed": 1.0,
}
"""What the page's words for a value are for a mission at 1 m/s, on three cells."""


def table(heading: str) -> dict[str, float]:
    """Parameter to value, from the page's table of a firmware."""
    lines = PAGE.split(f"| {heading} parameter |", 1)[1].split("\n\n", 1)[0].splitlines()[2:]
    values: dict[str, float] = {}
    for line in lines:
        names, said, *_ = (cell.strip() for cell in line.strip("|").split("|"))
        parameters = [re.sub(r" \(.*\)", "", name.strip()) for name in names.split(",")]
        if said == "as above":
            continue
        values |= dict(zip(parameters, map(number, said.split(", ")), strict=True))
    return values


def number(said: str) -> float:
    return WORDS[said] if said in WORDS else float(said)


def levels(firmware: Firmware, values: dict[str, float], demands: Demands) -> dict[str, str]:
    return {
        f"{check.name}: {check.found}": check.level
        for check in failsafes.judge("ada", firmware, values, 245, demands)
    }


def test_a_rover_set_up_to_the_letter_is_green() -> None:
    rover = table("ArduRover")
    assert rover["FS_ACTION"] == 2 and rover["FENCE_TYPE"] == 4
    for demands in (Demands(1.0), Demands(1.0, ((0.0, 0.0), (9.0, 0.0), (9.0, 9.0)), True)):
        found = levels(ROVER, rover, demands)
        assert set(found.values()) == {"green"}, found


def test_a_copter_set_up_to_the_letter_is_green() -> None:
    above = {name: value for name, value in table("ArduRover").items() if name.startswith(("FENCE_", "MAV_"))}
    found = levels(COPTER, above | {"FS_GCS_TIMEOUT": 5.0} | table("ArduCopter"), Demands(1.0))
    assert set(found.values()) == {"green"}, found


def test_a_px4_set_up_to_the_letter_is_green() -> None:
    said = PAGE.split("With PX4:", 1)[1].split("\n\n", 1)[0].replace("\n", " ")
    px4 = {name: float(value) for name, value in re.findall(r"`([A-Z0-9_]+)` (\d+)", said)}
    assert {"NAV_DLL_ACT", "COM_DL_LOSS_T", "GF_ACTION"} <= px4.keys()
    found = levels(PX4, px4 | {"MPC_XY_CRUISE": 1.0}, Demands(1.0))
    assert set(found.values()) == {"green"}, found
