"""Campaigns against the recording: kills and damage, many times over, each checked against what was written."""
