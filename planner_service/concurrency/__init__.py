"""Threads, forks and Ctrl-C: turns in order, locks after a fork, whole imports, and calls that end when told to."""
