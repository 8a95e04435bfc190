"""As much of LeRobot's interface as the package uses, for tests where LeRobot is not installed.

`make lerobot` runs the same tests with LeRobot itself.
"""
