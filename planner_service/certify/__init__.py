"""The proof that a whole curve is free, between samples too; it shares no code with the search."""

from planner_service.certify.certifier import (
    MARGIN,
    MAX_OVERLAP,
    Certificate,
    Certifier,
    ExemptInterval,
    Refusal,
    Trail,
    certify,
)
from planner_service.certify.gripper import GripperMotion, certify_gripper
from planner_service.certify.interval_proof import EdgeProof, EdgeVerdict
from planner_service.certify.kept_proof import Kept, KeptBound, KeptRefusal, prove_kept

__all__ = [
    "MARGIN",
    "MAX_OVERLAP",
    "Certificate",
    "Certifier",
    "EdgeProof",
    "EdgeVerdict",
    "ExemptInterval",
    "GripperMotion",
    "Kept",
    "KeptBound",
    "KeptRefusal",
    "Refusal",
    "Trail",
    "certify",
    "certify_gripper",
    "prove_kept",
]
