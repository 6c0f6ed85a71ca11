"""log p(what the team heard | a source in cell i transmitted)."""
