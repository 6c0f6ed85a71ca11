"""One suite per port, over every driver on its emulator and every stand-in."""

import pytest
import stand_ins
from benches import POSITION_SOURCES, RECEIVERS, VEHICLE_LINKS

from fieldkit.testing import check_position_source, check_receiver, check_vehicle_link

RECEIVERS |= {"fake": stand_ins.fake_receiver, "replay": stand_ins.played_receiver}
VEHICLE_LINKS |= {"fake": stand_ins.fake_fleet}
POSITION_SOURCES |= {"fake": stand_ins.fake_positions, "replay": stand_ins.played_positions}


@pytest.mark.parametrize("name", RECEIVERS)
async def test_receiver_conforms(name):
    await check_receiver(RECEIVERS[name])


@pytest.mark.parametrize("name", VEHICLE_LINKS)
async def test_vehicle_link_conforms(name):
    await check_vehicle_link(VEHICLE_LINKS[name])


@pytest.mark.parametrize("name", POSITION_SOURCES)
async def test_position_source_conforms(name):
    if name == "camera":
        pytest.importorskip("cv2", reason="OpenCV is not installed: pip install spog-fieldkit[camera]")
    await check_position_source(POSITION_SOURCES[name])
