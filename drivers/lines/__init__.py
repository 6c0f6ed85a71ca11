"""Any radio that prints: lines of text, mapped to readings by a few keys."""
