"""Motion planning for a robot arm on a table, with every collision check counted."""
