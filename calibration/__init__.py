"""From logged readings to an antenna file, or a clear no."""
