"""Positions and readings from files: for surveys with a hand-carried radio, and for missions played again."""
