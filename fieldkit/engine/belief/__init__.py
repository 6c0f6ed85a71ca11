"""What is believed about the sources after the detections and silences so far."""
