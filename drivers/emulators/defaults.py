"""What emulated devices are where nobody says, for the commands and for the emulators themselves."""

from typing import Final

PROFILE: Final = "s2c"
"""The XBee module."""
FIRMWARE: Final = "rover"
SOURCES = 3
"""Hidden transmitters."""
HIDDEN_HZ = 0.1
"""How often each sends."""
PICTURES_HZ = 16.0
