"""Serves the page: who may use it, what a window may send, and when it ends."""
