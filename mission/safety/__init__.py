"""The pure safety layer: rules for every command, watch over every robot, return in sequence."""
