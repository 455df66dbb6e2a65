"""A RotorLink node behind a pair of XBee modules: the node's payloads inside API frames."""
