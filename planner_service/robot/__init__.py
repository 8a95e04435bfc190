"""Robots as immutable values, and the files they are read from."""
