"""The pure mission: the mission file, the kernel that turns events into commands, advice before the start."""
