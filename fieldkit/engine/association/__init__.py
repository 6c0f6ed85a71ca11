"""From readings and poses to detections: what was one transmission, and who listened in silence."""
