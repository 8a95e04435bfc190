"""Visits that are to be put in order, in files, and what their order came to, as a section of a task file."""

from planner_service.records.visits.file import VISITS_FORMAT, Visits, load_visits, save_visits
from planner_service.records.visits.order import ORDER, OrderRecord, saved_order

__all__ = ["ORDER", "VISITS_FORMAT", "OrderRecord", "Visits", "load_visits", "save_visits", "saved_order"]
