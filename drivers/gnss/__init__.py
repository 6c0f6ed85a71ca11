"""Satellite navigation receivers: gpsd, and NMEA 0183 from a serial port, a network or a phone."""
