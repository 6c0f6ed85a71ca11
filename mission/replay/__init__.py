"""Missions run again from their recordings: replay, what-if, pace."""
