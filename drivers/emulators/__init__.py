"""Devices that answer on the wire as the real ones do, and misbehave on request."""
