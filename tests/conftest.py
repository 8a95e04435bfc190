"""What holds for all tests."""

import signal

signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
"""A shell in the background has its programs ignore Ctrl-C, nohup SIGHUP: tests that send one would wait for ever."""
