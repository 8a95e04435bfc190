"""Bringing in a robot of one's own, and checking that this machine computes what it should."""
