"""How received power falls with distance, and the antenna file that says so."""
