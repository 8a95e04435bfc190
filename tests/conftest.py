"""What holds for all tests."""

import signal

signal.signal(signal.SIGINT, signal.default_int_handler)
"""A shell in the background has its programs ignore Ctrl-C: tests that send one would wait for ever."""
