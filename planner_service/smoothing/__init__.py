"""Shorter paths with rounded corners."""
