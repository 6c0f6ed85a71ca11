"""What acts: runner, dispatcher, recorder, setups, preflight and terminal."""
