"""Shows what a gate decides: on a page while it does, and in pictures from its log."""
