"""Grasps."""
