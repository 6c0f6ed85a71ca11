"""The mission's notebook: one MCAP file, complete, safe and open to other tools."""
