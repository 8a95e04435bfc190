"""Motions as recordings for other viewers: Foxglove and Rerun."""
