"""Measured points, cells of trees and arrays, from files."""

from planner_service.geometry.scans.point_files import (
    MAX_POINTS,
    POINT_SUFFIXES,
    TREES,
    Scan,
    arrays_of,
    read_array,
    read_scan,
)

__all__ = ["MAX_POINTS", "POINT_SUFFIXES", "TREES", "Scan", "arrays_of", "read_array", "read_scan"]
