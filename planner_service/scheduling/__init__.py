"""Picks of several arms in one scene: who takes what and when, proven apart at all times before anything moves."""

from planner_service.scheduling.jobs import PickJob
from planner_service.scheduling.picks import schedule_picks
from planner_service.scheduling.prove import ProvenSchedule, prove_schedule
from planner_service.scheduling.result import Chain, Schedule

__all__ = ["Chain", "PickJob", "ProvenSchedule", "Schedule", "prove_schedule", "schedule_picks"]
