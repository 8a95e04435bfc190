"""How results, robots and scenes look as text and as HTML: what ``print``, notebooks, the CLI and the viewer show."""
