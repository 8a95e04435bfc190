"""Other planners on the same problems: each in an environment of its own, judged by the same independent checker."""
