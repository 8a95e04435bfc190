"""Pairs that could not be proven apart."""

from __future__ import annotations

from planner_service.certify import Certificate, Refusal

__all__ = ["refused_pair"]


def refused_pair(certificate: Certificate) -> Refusal:
    """The refusal of a certificate, which must be one for a pair."""
    assert isinstance(certificate.refusal, Refusal)
    return certificate.refusal
