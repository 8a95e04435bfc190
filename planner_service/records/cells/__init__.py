"""Plans of cells in files, each arm with its own clock, and proving them again over all clocks."""

from planner_service.records.cells.cell_file import SavedCellPlan, load_cell_plan, load_saved, save_cell_plan
from planner_service.records.cells.cell_request import CellRequest, read_cell_request
from planner_service.records.cells.evidence import with_cell_evidence
from planner_service.records.cells.prove import ProvenCell, prove_cell

__all__ = [
    "CellRequest",
    "ProvenCell",
    "SavedCellPlan",
    "load_cell_plan",
    "load_saved",
    "prove_cell",
    "read_cell_request",
    "save_cell_plan",
    "with_cell_evidence",
]
