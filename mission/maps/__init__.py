"""Other maps: what people's own get of a mission (GeoJSON, KML, Cursor on Target), and the ground under ours."""
