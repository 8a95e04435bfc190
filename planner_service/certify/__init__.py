"""The proof that a whole curve is free, between samples too; it shares no code with the search."""

from planner_service.certify.certifier import MARGIN, Certificate, Certifier, ExemptInterval, Refusal, certify
from planner_service.certify.edge import EdgeProof, EdgeVerdict

__all__ = [
    "MARGIN",
    "Certificate",
    "Certifier",
    "EdgeProof",
    "EdgeVerdict",
    "ExemptInterval",
    "Refusal",
    "certify",
]
