"""People who carry a radio: they follow advice, or not."""
