"""The present of a mission for Google Earth and the like: KML, and a link that fetches it again and again.

Written by hand: a few elements, and nobody who only looks should need an extra package.
"""

from typing import Any
from xml.etree import ElementTree

from mission.maps.geojson import collection
from mission.maps.present import Present

KML = "http://www.opengis.net/kml/2.2"
MEDIA_TYPE = "application/vnd.google-earth.kml+xml"
EVERY_S = 2


def network_link(name: str, address: str) -> bytes:
    """A file that, opened once, shows `address` for good and fetches it every `EVERY_S` seconds."""
    root = _root()
    link = _add(root, "NetworkLink")
    _add(link, "name", name)
    where = _add(link, "Link")
    _add(where, "href", address)
    _add(where, "refreshMode", "onInterval")
    _add(where, "refreshInterval", str(EVERY_S))
    return _bytes(root)


def document(present: Present) -> bytes:
    """What there is now."""
    root = _root()
    whole = _add(root, "Document")
    _add(whole, "name", present.name)
    for feature in collection(present)["features"]:
        _placemark(whole, feature)
    return _bytes(root)


def _placemark(parent: Any, feature: dict[str, Any]) -> None:
    properties, shape = feature["properties"], feature["geometry"]
    mark = _add(parent, "Placemark")
    mark.set("id", feature["id"])
    _add(mark, "name", properties["name"])
    said = (f"{key}: {value}" for key, value in properties.items() if value not in (None, "") and key != "id")
    _add(mark, "description", "\n".join(said))
    if shape["type"] == "Point":
        _add(_add(mark, "Point"), "coordinates", ",".join(map(str, shape["coordinates"])))
        return
    style = _add(_add(mark, "Style"), "PolyStyle")
    _add(style, "color", "500000ff")
    ring = _add(_add(_add(mark, "Polygon"), "outerBoundaryIs"), "LinearRing")
    _add(ring, "coordinates", " ".join(f"{lon},{lat}" for lon, lat in shape["coordinates"][0]))


def _root() -> Any:
    ElementTree.register_namespace("", KML)
    return ElementTree.Element(f"{{{KML}}}kml")


def _add(parent: Any, tag: str, text: str = "") -> Any:
    element = ElementTree.SubElement(parent, f"{{{KML}}}{tag}")
    if text:
        element.text = text
    return element


def _bytes(root: Any) -> bytes:
    ElementTree.indent(root)
    return bytes(ElementTree.tostring(root, encoding="utf-8", xml_declaration=True))
