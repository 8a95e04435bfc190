"""Grippers and tools of robot files: how they become values."""
