"""Plane geometry in the field frame: areas, segments and distances, used by planners and safety alike."""
