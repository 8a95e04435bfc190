"""What a proof without a list of open pairs would ask, to compare the certificate with."""

from __future__ import annotations

from planner_service.certify import MARGIN, Certifier
from planner_service.certify.interval_proof import ProofTree
from planner_service.errors import InvalidRequest
from planner_service.path.joint_path import JointPath

__all__ = ["plain_bisection_bounds"]


def plain_bisection_bounds(certifier: Certifier, path: JointPath, padding: float = 0.0) -> int:
    """The (configuration, pair) bounds asked when every stretch is cut for all pairs until all are proven on it.

    Bounds, tree and acceptance are the certificate's; only nothing is dropped that is proven.

    Raises:
        InvalidRequest: the path cannot be proven, so that there is nothing to compare.
    """
    tree = ProofTree(certifier.motion, path, padding + MARGIN, together=True)
    obstruction = tree.run(certifier.roots(path.length))
    if obstruction is not None:
        a, b = certifier.listed.names(obstruction.pair)
        raise InvalidRequest("path", f"{a} x {b}: {obstruction.detail}", "a path that can be certified")
    return tree.bounds
