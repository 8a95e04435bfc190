"""The folder of a server, which outlives it: an index, contents by their hash, and a lock."""
