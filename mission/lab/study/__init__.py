"""Studies: many simulated missions, measured."""
