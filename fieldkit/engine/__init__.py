"""Belief and planning: pure, clockless, on a grid of cells indexed [north, east]."""
