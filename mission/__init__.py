"""Missions: the pure kernel and safety, the shell that runs them, and what is made of their recordings."""
