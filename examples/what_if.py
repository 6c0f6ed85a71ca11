"""What if the engine had asked for more certainty, or for less? The same recording, other settings.

    python examples/what_if.py runs/20260102T030405Z/mission.mcap

Robots stay on their recorded paths: this tells what the belief would have made of the same receptions.
"""

import sys
from pathlib import Path

from fieldkit.recording import open_recording
from mission.replay.replay import recorded_mission, replay, what_if


def main(path: str) -> None:
    """Print for each setting how many sources are found, and when the last of them was."""
    flown = recorded_mission(open_recording(path))
    for probability in (0.8, 0.9, 0.95, 0.99):
        asked = what_if(flown, changes=[f"engine.found_probability={probability}"])
        done = replay(Path(path), mission=asked, check=False)
        found = [source for source in done.kernel.sources() if source.state == "found"]
        last_s = max(done.kernel.found_at_s.values(), default=float("nan"))
        print(f"P {probability:.2f}: {len(found)} found, the last after {last_s:.0f} s")


if __name__ == "__main__":
    main(sys.argv[1])
