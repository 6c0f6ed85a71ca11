"""Draw docs/demo.png from a demo's recording: python docs/picture.py runs/<UTC>/mission.mcap"""

import sys
from pathlib import Path

from mission.analysis.history import read_history
from mission.analysis.plots import field_map

figure = field_map(read_history(Path(sys.argv[1])))
figure.savefig(Path(__file__).with_name("demo.png"), dpi=110, bbox_inches="tight")
