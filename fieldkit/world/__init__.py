"""Simulated truth: sources, the radio channel and robots that drive."""
