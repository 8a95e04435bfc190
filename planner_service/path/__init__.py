"""Curves through joint space, and trajectories along them."""
