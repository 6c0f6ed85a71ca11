"""The wires: radios, vehicles and position sources, and emulators of each."""
