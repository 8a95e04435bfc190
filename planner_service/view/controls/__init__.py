"""The controls of the page, and its plots."""
