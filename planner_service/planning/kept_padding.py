"""The padding that a motion keeps: the requested one, except near an end that is closer to something.

A pair that is closer than the padding at an end may be so until it has come apart; all other pairs keep the padding
there, too. Samples say how far from the end that is. That all the rest keeps the padding is proven.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace

from planner_service.certify import Certificate, Certifier, ExemptInterval, Refusal
from planner_service.collision import CollisionChecker
from planner_service.path.joint_path import JointPath
from planner_service.planning.accounting import PlanAccounting
from planner_service.planning.result import KeptPadding, NearEnd, Stage

__all__ = ["free_but_for", "line_keeps_padding", "padding_kept"]

Pair = tuple[str, str]
Span = tuple[float, float]

SHARES = (1.0, 0.75, 0.5, 0.25, 0.125)
"""Of the requested padding: the first that can be proven is what a motion keeps."""

FIRST_STEP = 0.01
"""Radians from an end at which to look first whether pairs have come apart there; then twice as far, and so on."""

HALVINGS = 5
"""Of the last step, to say more closely where they do."""

WIDER, BEYOND = 1.01, 1e-5
"""How much more than the padding, as a factor and in metres, pairs keep from where they are held to it: room for the
proof, which keeps a margin."""

WIDEST = 0.1
"""Metres: no checker has more padding."""

LONGEST, LARGEST_PART = 0.5, 0.4
"""A straight line may keep less so far (rad) from an end that is close, and on so much of its length."""

HALF = 0.5
"""Of a motion: pairs that are closer than the padding on more than that are so not only near an end."""

SPACING = 0.02
"""Radians between samples at which all other pairs are to keep the padding near an end."""


def padding_kept(
    path: JointPath,
    certificate: Certificate,
    asked: float,
    checker: CollisionChecker,
    certifier: Certifier,
    accounting: PlanAccounting,
    *,
    span: Span | None = None,
) -> KeptPadding:
    """How much of the requested padding a proven motion keeps; part of the CERTIFY stage.

    Args:
        span: The part of the path that is to keep it; None for all of it.
    """
    if certificate.clearance >= asked:
        return KeptPadding(asked)
    span = (0.0, path.length) if span is None else span
    plain = [replace(stretch, depth=None) for stretch in certificate.exempt]  # the depth is proven already
    kept, why = KeptPadding(max(0.0, min(asked, certificate.clearance))), ""

    def proven(padding: float, near: Sequence[NearEnd]) -> Certificate:
        exempt = (*plain, *(ExemptInterval(each.s_start, each.s_end, each.pairs, "close") for each in near))
        return certifier.certify(path, padding=padding, exempt=exempt, part=span, charge=accounting.ledger.charge)

    with accounting.during(Stage.CERTIFY, improving="proven with more padding") as entry:
        entry.note = certificate.verdict
        proof = proven(asked, ())
        if proof.certified:
            return KeptPadding(asked, proof=replace(proof, exempt=certificate.exempt, kept=certificate.kept))
        if isinstance(proof.refusal, Refusal):
            why = f"{proof.refusal.what} at s = {proof.refusal.s:.3g}"
        for padding in (asked * share for share in SHARES):
            if padding <= kept.padding:
                break
            near = _near_ends(path, checker, padding, certificate, span)
            if near is None:
                continue
            proof = proven(padding, near)
            if proof.certified:
                kept = KeptPadding(padding, near)
                break
            if padding == asked and isinstance(proof.refusal, Refusal):
                why = f"{proof.refusal.what} at s = {proof.refusal.s:.3g}"
    return replace(kept, note=_in_words(kept, asked, why))


def line_keeps_padding(line: JointPath, checker: CollisionChecker, padding: float) -> bool:
    """Whether a straight line that is free keeps a padding except near its ends, as far as samples show."""
    first, last = (_near_end(line, checker, padding, (0.0, line.length), (), last=last) for last in (False, True))
    most = min(LONGEST, LARGEST_PART * line.length)
    begin = 0.0 if first is None else first.s_end
    end = line.length if last is None else last.s_start
    if begin > most or line.length - end > most:
        return False
    padded = checker.variant(padding=padding)
    ends = [near for near in (first, last) if near is not None]
    if not all(free_but_for(near.pairs, line, (near.s_start, near.s_end), padded) for near in ends):
        return False
    return padded.edge_is_free(line(begin), line(end))


def free_but_for(pairs: Collection[Pair], path: JointPath, span: Span, padded: CollisionChecker) -> bool:
    """Whether nothing but the named pairs touches at samples of a part of a path."""
    begin, end = span
    parts = max(1, round((end - begin) / SPACING))
    samples = (begin + (end - begin) * k / parts for k in range(parts + 1))
    return all(_touching(padded, path, s) <= set(pairs) for s in samples)


def _near_ends(
    path: JointPath, checker: CollisionChecker, padding: float, certificate: Certificate, span: Span
) -> tuple[NearEnd, ...] | None:
    """Where pairs are closer than a padding at the ends; None if that is on more than half of the way."""
    ends = (_near_end(path, checker, padding, span, certificate.exempt, last=last) for last in (False, True))
    near = tuple(each for each in ends if each is not None)
    short = all(each.s_end - each.s_start <= HALF * (span[1] - span[0]) for each in near)
    return near if short else None


def _near_end(
    path: JointPath,
    checker: CollisionChecker,
    padding: float,
    span: Span,
    exempt: Sequence[ExemptInterval],
    *,
    last: bool,
) -> NearEnd | None:
    """The pairs that are closer than a padding at an end of a part of a path, and how far from it; None if none is."""
    padded = checker.variant(padding=min(WIDEST, WIDER * padding + BEYOND))
    begin, length = span[0], span[1] - span[0]

    def s(distance: float) -> float:
        return span[1] - distance if last else begin + distance

    throughout = [stretch for stretch in exempt if stretch.s_start <= span[0] and span[1] <= stretch.s_end]
    excused = {frozenset(pair) for stretch in throughout for pair in stretch.pairs}
    pairs = {pair for pair in _touching(padded, path, s(0.0)) if frozenset(pair) not in excused}
    if not pairs:
        return None
    close, far = 0.0, min(FIRST_STEP, length)
    while far < length and pairs & _touching(padded, path, s(far)):
        close, far = far, min(2.0 * far, length)
    if far < length or not pairs & _touching(padded, path, s(length)):
        for _ in range(HALVINGS):
            middle = (close + far) / 2.0
            close, far = (middle, far) if pairs & _touching(padded, path, s(middle)) else (close, middle)
    low, high = sorted((s(0.0), s(far)))
    return NearEnd(max(low, span[0]), min(high, span[1]), tuple(sorted(pairs)))


def _touching(padded: CollisionChecker, path: JointPath, s: float) -> frozenset[Pair]:
    return padded.touching(path(min(max(s, 0.0), path.length)))


def _in_words(kept: KeptPadding, asked: float, why: str) -> str:
    parts = []
    if kept.padding < asked:
        near = f": {why}" if why else ""
        known = math.floor(1e7 * kept.padding) / 1e4
        parts.append(f"{known:g} mm are proven, less than the padding of {1e3 * asked:g} mm{near}")
    parts += [f"closer than {1e3 * kept.padding:g} mm, as at that end, {near}" for near in kept.near_ends]
    return "; ".join(parts)
