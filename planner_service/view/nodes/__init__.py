"""What the page draws, as nodes of a viser scene."""
