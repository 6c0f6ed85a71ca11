"""Promiscuous 802.15.4 receivers: sniffer dongles and captures. They hear networks that are not ours."""
