"""The laboratory: studies, campaigns, benchmarks, simulated missions. A live mission imports none of it."""
