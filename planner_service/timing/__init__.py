"""Time laws: how fast an arm may go along a path."""
