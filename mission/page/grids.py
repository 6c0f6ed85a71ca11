"""Numbers over the field as a browser is sent them: reduced to what a screen shows, a byte a cell."""

import base64
import math

import numpy as np

from fieldkit.messages import FloatArray
from mission.page.protocol import Grid, GridName

GRID_SIDE = 128
"""Most cells along a side of a grid that is sent; larger ones are reduced, a block to its largest value."""

ABOVE_USUAL = 8.0
"""The brightest colour means at least this many times the usual cell: a field where nothing is known yet is dark."""


def grid(name: GridName, values: FloatArray, cell_m: float, scale: float | None = None) -> Grid:
    """A grid (n_north, n_east) as bytes, row 0 south: the square root of the share of `scale` or of its largest."""
    block = max(1, math.ceil(max(values.shape) / GRID_SIDE))
    if block > 1:
        rows, columns = (-(-n // block) * block for n in values.shape)
        padded = np.zeros((rows, columns))
        padded[: values.shape[0], : values.shape[1]] = values
        values = padded.reshape(rows // block, block, columns // block, block).max(axis=(1, 3))
    largest = float(np.nanmax(values)) if scale is None else scale
    top = scale if scale is not None else max(largest, ABOVE_USUAL * float(np.nanmedian(values)))
    share = np.clip(np.nan_to_num(values) / top, 0.0, 1.0) if top > 0 else np.zeros_like(values)
    data = np.round(255.0 * np.sqrt(share)).astype(np.uint8)
    return {
        "kind": "grid",
        "name": name,
        "n_east": int(values.shape[1]),
        "n_north": int(values.shape[0]),
        "cell_m": cell_m * block,
        "largest": largest,
        "data": base64.b64encode(data.tobytes()).decode("ascii"),
    }
