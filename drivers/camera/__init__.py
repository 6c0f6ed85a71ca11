"""An overhead camera as a position source. OpenCV (extra `[camera]`) is imported by what uses it, when it is used."""
