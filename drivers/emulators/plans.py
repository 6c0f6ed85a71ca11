"""An autopilot's store of missions, fences and rally points, written in place as ArduPilot does it.

Measured on ArduRover 4.7: asks with MISSION_REQUEST, again after 1 s, and gives up after 8 s with
OPERATION_CANCELLED and a mixture of old and new; a duplicate item is answered with INVALID_SEQUENCE and the
upload goes on; another ground station is DENIED meanwhile.
"""

from dataclasses import dataclass, field

from drivers.mavlink.codec import Message, mavlink

ASK_AGAIN_S, GIVE_UP_S = 1.0, 8.0


@dataclass
class _Upload:
    """An upload under way."""

    kind: int
    count: int
    station: tuple[int, int]
    next_number: int = 0
    asked_s: float = 0.0
    heard_s: float = 0.0


@dataclass
class PlanStore:
    """Plans by MAV_MISSION_TYPE, as MISSION_ITEM_INT messages."""

    items: dict[int, list[Message]] = field(default_factory=dict)
    _upload: _Upload | None = None

    def hear(self, message: Message, t_s: float) -> list[Message]:
        """A message of the mission protocol; the answers."""
        kind = message.get_type()
        station = (message.get_srcSystem(), message.get_srcComponent())
        if kind == "MISSION_COUNT":
            return self._begin(message, station, t_s)
        if kind == "MISSION_ITEM_INT":
            return self._item(message, station, t_s)
        held = self.items.get(message.mission_type, []) if hasattr(message, "mission_type") else []
        if kind == "MISSION_REQUEST_LIST":
            return [mavlink.MAVLink_mission_count_message(*station, len(held), message.mission_type)]
        if kind in ("MISSION_REQUEST_INT", "MISSION_REQUEST"):
            return [self._readdressed(held[message.seq], station)] if message.seq < len(held) else []
        if kind == "MISSION_CLEAR_ALL":
            self.items[message.mission_type] = []
            return [self._ack(station, 0, message.mission_type)]
        return []

    def update(self, t_s: float) -> list[Message]:
        """Time passes: ask again, or give up."""
        upload = self._upload
        if upload is None:
            return []
        if t_s - upload.heard_s > GIVE_UP_S:
            self._upload = None
            return [self._ack(upload.station, mavlink.MAV_MISSION_OPERATION_CANCELLED, upload.kind)]
        return self._ask(t_s) if t_s - upload.asked_s > ASK_AGAIN_S else []

    def _begin(self, message: Message, station: tuple[int, int], t_s: float) -> list[Message]:
        if self._upload is not None and self._upload.station != station:
            return [self._ack(station, mavlink.MAV_MISSION_DENIED, message.mission_type)]
        self._upload = _Upload(message.mission_type, message.count, station, heard_s=t_s)
        return self._ask(t_s)

    def _ask(self, t_s: float) -> list[Message]:
        upload = self._upload
        assert upload is not None
        upload.asked_s = t_s
        return [mavlink.MAVLink_mission_request_message(*upload.station, upload.next_number, upload.kind)]

    def _item(self, message: Message, station: tuple[int, int], t_s: float) -> list[Message]:
        upload = self._upload
        if upload is None or station != upload.station or message.mission_type != upload.kind:
            return [self._ack(station, mavlink.MAV_MISSION_ERROR, message.mission_type)]
        if message.seq != upload.next_number:
            return [self._ack(station, mavlink.MAV_MISSION_INVALID_SEQUENCE, upload.kind)]
        held = self.items.setdefault(upload.kind, [])
        held[message.seq : message.seq + 1] = [message]
        upload.next_number, upload.heard_s = upload.next_number + 1, t_s
        if upload.next_number < upload.count:
            return self._ask(t_s)
        del held[upload.count :]
        self._upload = None
        return [self._ack(station, mavlink.MAV_MISSION_ACCEPTED, upload.kind)]

    @staticmethod
    def _ack(station: tuple[int, int], result: int, kind: int) -> Message:
        return mavlink.MAVLink_mission_ack_message(*station, result, kind)

    @staticmethod
    def _readdressed(item: Message, station: tuple[int, int]) -> Message:
        numbers = (item.param1, item.param2, item.param3, item.param4, item.x, item.y, item.z)
        head = (item.seq, item.frame, item.command, item.current, item.autocontinue)
        return mavlink.MAVLink_mission_item_int_message(*station, *head, *numbers, item.mission_type)
