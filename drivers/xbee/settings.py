"""What a module says of itself, and whether it can tell how strongly it hears; read, never changed.

Parameters: Digi 90000982 (S1), 90001500 (S2C 802.15.4), 90002273 (XBee 3 802.15.4).
"""

from dataclasses import dataclass, field

from digi.xbee.devices import XBeeDevice
from digi.xbee.exception import ATCommandException
from digi.xbee.models.protocol import XBeeProtocol

SATURATION_DBM = -40.0
"""S1, S2C and XBee 3 are linear up to about -40 dBm; what is reported above is a lower bound."""
SATURATION_PRO_DBM = -36.0
SENSITIVITY_DBM = {0x17: -92.0, 0x18: -100.0, 0x41: -103.0, 0x42: -103.0, 0x23: -101.0}
"""First byte of HV to what is still received, from the data sheets; weaker packets are lost, not reported."""
S1_PRO = 0x18
_NAMES = {0x17: "S1", S1_PRO: "S1 PRO"}
_S1 = (0x17, S1_PRO)


@dataclass(frozen=True, slots=True)
class ModuleSettings:
    """A module's answers. A parameter its firmware does not know is None."""

    address: str
    """SH and SL, 16 hexadecimal digits: the module's identity."""
    hardware: int
    """First byte of HV."""
    hardware_name: str
    protocol: XBeeProtocol
    firmware: str
    api_mode: int
    values: dict[str, int | None] = field(default_factory=dict)
    """AO, MM, MY, ID, CH."""

    @property
    def channel(self) -> int | None:
        return self.values.get("CH")

    @property
    def sensitivity_dbm(self) -> float | None:
        """The weakest it hears, about; None where that is not known."""
        return SENSITIVITY_DBM.get(self.hardware)

    @property
    def is_s1(self) -> bool:
        return self.hardware in _S1

    @property
    def is_mesh(self) -> bool:
        """Packets may come over relays, whose strength is then what DB says."""
        result: bool = self.protocol != XBeeProtocol.RAW_802_15_4
        return result

    @property
    def saturation_dbm(self) -> float:
        return SATURATION_PRO_DBM if self.hardware == S1_PRO else SATURATION_DBM

    def describe(self) -> str:
        channel = "" if self.channel is None else f", channel {self.channel}"
        ends = "" if self.sensitivity_dbm is None else f"{self.sensitivity_dbm:g} to "
        return (
            f"XBee {self.hardware_name}, firmware {self.firmware}, address {self.address}{channel}, "
            f"hears {ends}{self.saturation_dbm:g} dBm"
        )


def read_settings(device: XBeeDevice) -> ModuleSettings:
    """Ask an opened module. Raises the library's errors if it stops answering."""
    hardware = device.get_hardware_version()
    return ModuleSettings(
        address=str(device.get_64bit_addr()),
        hardware=hardware.code,
        hardware_name=_NAMES.get(hardware.code, hardware.description),
        protocol=device.get_protocol(),
        firmware=bytes(device.get_firmware_version()).hex().upper(),
        api_mode=device.operating_mode.code,
        values={name: _ask(device, name) for name in ("AO", "MM", "MY", "ID", "CH")},
    )


def _ask(device: XBeeDevice, name: str) -> int | None:
    try:
        return int.from_bytes(device.get_parameter(name, apply=False), "big")
    except ATCommandException:
        return None


def why_it_cannot_hear(settings: ModuleSettings) -> str:
    """Why this module cannot give strengths, with the remedy; empty if it can."""
    if settings.protocol != XBeeProtocol.RAW_802_15_4:
        return (
            f"runs {settings.protocol.description} firmware, whose receive frames carry no RSSI; "
            "write 802.15.4 firmware to it with XCTU (S2C: product family XB24C, function set 802.15.4 TH), "
            "or give the receiver `ask_db = true` and make do with the last hop's strength"
        )
    output = settings.values["AO"]
    if settings.hardware not in _S1 and output != 2:
        return (
            f"has AO={output}: its receive frames (0x9{'0' if not output else '1'}) carry no RSSI; "
            "set AO=2 (legacy frames) with XCTU and write it (WR), or give the receiver `ask_db = true`"
        )
    return ""


def advice(settings: ModuleSettings) -> list[str]:
    """Settings that work but spoil listening, each with the remedy."""
    found: list[str] = []
    if settings.is_mesh:
        found.append(
            "mesh firmware: strengths come from ATDB, are the last relay's, and name no sender; "
            "use 802.15.4 firmware to search"
        )
    elif not settings.is_s1 and settings.values["AO"] != 2:
        found.append(
            f"AO={settings.values['AO']}: strengths come from ATDB, one at a time; "
            "set AO=2, so that every frame carries its own"
        )
    if settings.api_mode == 1:
        found.append("AP=1: a damaged byte can cost the following frame; AP=2 resynchronises at once")
    if not settings.is_mesh and settings.values["MM"] not in (1, None):
        found.append(
            f"MM={settings.values['MM']}: set MM=1, so that it acknowledges nothing and hears foreign frames"
        )
    if settings.values["ID"] == 0xFFFF:
        found.append("ID=FFFF: packets of all PANs on the channel that are broadcast to all are heard")
    if not settings.is_mesh and settings.values["MY"] not in (0xFFFE, 0xFFFF, None):
        found.append(f"MY={settings.values['MY']:04X}: set MY=FFFE, so that receptions come as 64-bit frames")
    return found
