"""Which robot heard what, how strongly and where: readings and poses as numpy arrays.

    python examples/heard_where.py runs/20260102T030405Z/mission.mcap

The arrays are structured: `pandas.DataFrame(log.readings)` or `polars.DataFrame(log.readings)` takes them as they are.
"""

import sys

import numpy as np

import fieldkit


def main(path: str) -> None:
    """Print a line a robot."""
    log = fieldkit.open_log(path)
    if not log.recording.complete:
        print(f"note: {log.recording.missing}")
    for robot in np.unique(log.poses["robot"]):
        track = log.poses[log.poses["robot"] == robot]
        driven_m = np.hypot(np.diff(track["east_m"]), np.diff(track["north_m"])).sum()
        heard = log.readings[log.readings["robot"] == robot]
        line = f"{robot}: drove {driven_m:.0f} m, heard {len(heard)} packets"
        if len(heard):
            best = heard[np.argmax(heard["rss_dbm"])]
            line += (
                f", the strongest at {best['rss_dbm']:.0f} dBm after {best['t_s']:.0f} s, "
                f"{best['east_m']:.1f} m east {best['north_m']:.1f} m north"
            )
        print(line)


if __name__ == "__main__":
    main(sys.argv[1])
