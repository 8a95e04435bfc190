"""Builds a cell: obstacles are added, moved, sized, named, coloured and deleted, and files read and written."""
