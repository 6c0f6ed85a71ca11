"""The default belief: sources as candidates with a place, a power and a rate each; silence is evidence."""
