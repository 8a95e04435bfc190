"""Time laws: how fast an arm may go along a path."""

from planner_service.timing.laws import SCurve, Timing, TimingFailed, ToppRa, Trapezoidal

__all__ = ["SCurve", "Timing", "TimingFailed", "ToppRa", "Trapezoidal"]
