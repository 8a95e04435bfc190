"""The worlds that are planned in: stored queries, and worlds drawn from a seed."""
