"""The mission's commands."""
