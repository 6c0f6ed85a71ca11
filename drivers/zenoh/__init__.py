"""Agents' messages over Eclipse Zenoh: peer to peer, no broker."""
