"""Arms, worlds and browsers that tests share."""
