"""The mission editor: what `fieldkit plan` does with a mission file, and serves to its page."""
