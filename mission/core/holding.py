"""Whether a vehicle that was told to hold does: by what it shows, not by what it was told. Pure."""

from fieldkit.messages import VehicleState
from fieldkit.settings import DRIFTS_M_S, STANDS_M_S


def moves(vehicle: VehicleState) -> bool:
    """Whether it is faster over ground than one that stands, or hovers; one that does not say how fast it is is not."""
    most_m_s = DRIFTS_M_S if vehicle.flies else STANDS_M_S
    return vehicle.speed_m_s is not None and vehicle.speed_m_s > most_m_s


def rolls(vehicle: VehicleState) -> bool:
    """Whether it says that it holds, and moves."""
    return vehicle.mode == "hold" and moves(vehicle)


def holds(vehicle: VehicleState) -> bool:
    """Whether it shows that it holds."""
    return vehicle.mode == "hold" and vehicle.link_up and not moves(vehicle)
