"""Find unknown, short-lived radio transmitters with a team of small robots."""

__version__ = "0.1.0"
