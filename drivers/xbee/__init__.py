"""Digi XBee modules as passive receivers, through the digi-xbee library."""
