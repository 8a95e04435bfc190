"""Trajectories in the formats of other tools."""
