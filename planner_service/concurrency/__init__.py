"""Threads, forks and Ctrl-C: a fair lock, locks after a fork, uninterrupted imports, and calls that can be ended."""
