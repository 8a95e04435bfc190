"""Several arms driven together."""
