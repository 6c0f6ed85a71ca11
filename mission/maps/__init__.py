"""What other people's maps get of a mission: GeoJSON, KML and Cursor on Target, while it goes on."""
