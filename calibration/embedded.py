"""The fitted readings inside the report's own page, as a file to be saved from it and imported again."""

import gzip
import re
from base64 import b64decode, b64encode
from binascii import Error as Base64Error
from pathlib import Path

import numpy as np

from calibration.dataset import Readings
from calibration.table import as_csv
from fieldkit.errors import DataError
from fieldkit.files import is_stream

_LINK = re.compile(r'href="data:application/gzip;base64,([A-Za-z0-9+/=]*)"')


def link(readings: Readings) -> str:
    """The address of a link that saves the readings as readings.csv.gz."""
    packed = gzip.compress(readings_csv(readings).encode(), mtime=0)
    return f"data:application/gzip;base64,{b64encode(packed).decode()}"


def readings_csv(readings: Readings) -> str:
    """Readings as a file that `read_readings` takes."""
    r = readings
    columns: dict[str, list[str]] = {
        "place": [r.places[k] for k in r.place],
        "distance_m": [f"{x:.6g}" for x in r.distance_m],
    }
    for end, place in (("tx", r.tx_m), ("rx", r.rx_m)):
        if place is not None:
            columns[f"{end}_east_m"] = [f"{x:.4f}" for x in place[:, 0]]
            columns[f"{end}_north_m"] = [f"{x:.4f}" for x in place[:, 1]]
    if r.heading_deg is not None:
        columns["heading_deg"] = [f"{x:g}" for x in r.heading_deg]
    if r.receiver is not None:
        columns["receiver"] = [r.receivers[k] for k in r.receiver]
    if r.order is not None:
        columns["time"] = [f"{x:.3f}" for x in r.order]
    columns["sample"] = [str(i) for i in range(len(r.rss_dbm))]
    columns["rss_dbm"] = ["" if np.isnan(z) else f"{z:g}" for z in r.rss_dbm]
    return as_csv(list(columns), list(zip(*columns.values(), strict=True)))


def readings_in(path: Path) -> str | None:
    """The readings a report carries, as CSV; None where it carries none. Raises `DataError` if damaged."""
    if is_stream(path):
        raise DataError(f"{path}: expected a report, got a pipe or device")
    try:
        found = _LINK.search(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise DataError(f"{path}: no such file; name a report of fieldkit calibrate fit --report") from None
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"{path}: is not a report of ours: {error}") from error
    if found is None:
        return None
    try:
        return gzip.decompress(b64decode(found.group(1), validate=True)).decode()
    except (Base64Error, OSError, EOFError, UnicodeDecodeError, ValueError) as error:
        raise DataError(
            f"{path}: the readings in it are damaged ({error}); import the file it was made from"
        ) from error
