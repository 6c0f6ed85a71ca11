"""A radio, a belief, a planner and a command for fieldkit."""
