"""Fixtures for the page in a real browser; see `flying`."""

from flying import browser, flown, walking

__all__ = ["browser", "flown", "walking"]
