"""Cursor on Target: a place as an event that ATAK, WinTAK and iTAK show, and a package of such events. Through pytak.

pytak stamps events with the time of their making, and cuts coordinates to four digits, which are eleven metres: both
are replaced here.
"""

import io
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from typing import Any
from uuid import NAMESPACE_URL, uuid5
from xml.etree import ElementTree

DIGITS = 7
"""Of latitude and longitude: a centimetre."""
UNKNOWN_GROUND = "a-u-G"
FRIEND_GROUND = "a-f-G"
FRIEND_ROTARY = "a-f-A-M-H-Q"
SPOT = "b-m-p-s-m"
"""A point somebody has set on the map."""
FUSED, BY_SATELLITE, ESTIMATED = "m-f", "m-g", "h-e"
"""How a place is known: put together by a machine, from satellites, by a person's judgement."""


@dataclass(frozen=True, slots=True)
class Marker:
    """What one event says."""

    uid: str
    """The same for the same thing: a later event replaces an earlier one."""
    kind: str
    how: str
    lat_deg: float
    lon_deg: float
    error_90_m: float | None
    """Radius of the circle that holds it with 90 %; None where that is not known."""
    callsign: str
    remarks: str
    t_ns: int
    stale_s: float
    """After so long without a newer one it is shown as old."""


@cache
def load_pytak() -> Any:
    """The package, without its warnings about packages for servers with certificates, which nothing here needs."""
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import pytak
    return pytak


def event(marker: Marker) -> bytes:
    """One event as XML, with a newline behind it."""
    pytak = load_pytak()
    point = pytak.cot_point(
        f"{marker.lat_deg:.{DIGITS}f}",
        f"{marker.lon_deg:.{DIGITS}f}",
        ce=None if marker.error_90_m is None else f"{marker.error_90_m:.1f}",
        precision=DIGITS,
    )
    detail = pytak.cot_detail(flow_tag=False)
    pytak.add_remarks(detail, [marker.remarks])
    made: ElementTree.Element = pytak.cot_event(
        uid=marker.uid,
        cot_type=marker.kind,
        how=marker.how,
        point=point,
        detail=detail,
        callsign=marker.callsign,
    )
    for name, t_ns in (
        ("time", marker.t_ns),
        ("start", marker.t_ns),
        ("stale", marker.t_ns + round(marker.stale_s * 1e9)),
    ):
        made.set(name, _w3c(t_ns))
    return bytes(pytak.serialize_cot(made, trailing_newline=True))


def _w3c(t_ns: int) -> str:
    """A dateTime of XML Schema."""
    seconds, rest = divmod(t_ns, 1_000_000_000)
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%dT%H:%M:%S}.{rest // 1000:06d}Z"


def data_package(name: str, markers: Sequence[Marker]) -> bytes:
    """A zip file that the TAK programs import: the events, and a manifest that names them."""
    package = str(uuid5(NAMESPACE_URL, f"{name}/{'/'.join(marker.uid for marker in markers)}"))
    manifest = ElementTree.Element("MissionPackageManifest", version="2")
    configuration = ElementTree.SubElement(manifest, "Configuration")
    for key, value in (("uid", package), ("name", name)):
        ElementTree.SubElement(configuration, "Parameter", name=key, value=value)
    contents = ElementTree.SubElement(manifest, "Contents")
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for marker in markers:
            entry = f"{marker.uid}/{marker.uid}.cot"
            content = ElementTree.SubElement(contents, "Content", ignore="false", zipEntry=entry)
            ElementTree.SubElement(content, "Parameter", name="uid", value=marker.uid)
            archive.writestr(_entry(entry), event(marker))
        ElementTree.indent(manifest)
        archive.writestr(_entry("MANIFEST/manifest.xml"), ElementTree.tostring(manifest, encoding="utf-8"))
    return packed.getvalue()


def _entry(name: str) -> zipfile.ZipInfo:
    """Without the time of writing: the same recording gives the same bytes."""
    return zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
