"""How things look to people on a terminal."""
