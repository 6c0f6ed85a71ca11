"""Telling the story of a candidate afresh, as one source and as two, and keeping the story with more evidence.

Points dropped early and shares that vouch for each other can hold a candidate in a wrong place, or hold two near
sources together: sweeps alone do not get out of that.
"""

import copy
import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fieldkit.engine.belief.candidate import RATE_SHAPE, Candidate, Rival, active_entries, log_sum
from fieldkit.messages import FloatArray

if TYPE_CHECKING:
    from fieldkit.engine.belief.mixture import Mixture

FIRST = 5.0
"""Receptions at which a candidate's story is first told afresh; then at every 1.4 times as many."""
UNDECIDED_NATS = -3.0
"""Evidence of the best story of two over that of one from which on somebody has to go and see."""
PLACE_ROUNDS = 6
"""Turns in which one of two places is chosen anew given the other."""
BETTER_NATS = 1.0
"""Evidence by which another story must be better."""


def revise(mixture: "Mixture") -> bool:
    """Tell the story of a candidate afresh, as one source and as two; whether another story was better.

    Points dropped early and shares that vouch for each other can hold a candidate in a wrong place, or hold two
    near sources together. A doubtful candidate is looked at again soon, others ever more rarely. One
    and two are compared on a point a cell; the better story is then told on the usual points.
    """
    changed = False
    for candidate in list(mixture.candidates):
        due = mixture.revise_at.setdefault(candidate.ident, FIRST)
        count = candidate.receptions
        if count < due or candidate.absorbed > 0.0:
            continue
        doubtful = candidate.state == "doubtful"
        mixture.revise_at[candidate.ident] = max(count + 0.9, (1.1 if doubtful else 1.4) * count)
        share = {number: share for number, share in candidate.share.items() if share > 0.05}
        blank = _fresh(mixture, candidate, share, spacing=1.0)
        single = _alike(blank)
        for number, part in share.items():
            single.set_share(number, part)
        pairs = _two(mixture, blank, share)
        scores = [_score(pair, share) for pair in pairs]
        odds_nats = max(scores, default=-np.inf) - _score([single], share)
        candidate.rival = None
        undecided = odds_nats > UNDECIDED_NATS
        if pairs:
            places = np.array([_mean(part) for part in pairs[int(np.argmax(scores))]])
            candidate.rival = Rival(float(1.0 / (1.0 + np.exp(-odds_nats))), places, undecided)
        if undecided:
            mixture.revise_at[candidate.ident] = min(mixture.revise_at[candidate.ident], count + 1.9)
        if odds_nats > BETTER_NATS:
            parts = [_retold(mixture, candidate, part.share) for part in pairs[int(np.argmax(scores))]]
        else:
            moved = np.abs(_mean(single) - mixture.summary(candidate).mean_m).max() > mixture.grid.cell_m
            if not (moved or doubtful):
                continue
            parts = [_retold(mixture, candidate, share)]
            if _score(parts, share) < _score([candidate], share) + BETTER_NATS:
                continue
        mixture.remove(candidate)
        parts[0].ident = candidate.ident
        parts[0].state = candidate.state
        mixture.candidates += parts
        for retold in parts:
            _know_all(mixture, retold)
        changed = True
    return changed


def _mean(candidate: Candidate) -> FloatArray:
    return np.asarray(candidate.posterior().sum(axis=0) @ candidate.points_m)


def _know_all(mixture: "Mixture", candidate: Candidate) -> None:
    for number, other in mixture.open.items():
        if number not in candidate.logs and mixture.in_reach(candidate, other):
            candidate.know(number, mixture.model.log_likelihood(other.detection, candidate.points_m))


def _fresh(
    mixture: "Mixture", candidate: Candidate, share: dict[int, float], *, spacing: float | None = None
) -> Candidate:
    """An empty candidate whose cloud covers wherever the given detections may have come from."""
    centre = mixture.summary(candidate).mean_m
    half = 0.75 * mixture.model.reach_m
    row0, row1, column0, column1 = mixture.grid.box_around(centre[None, :], half)
    fresh = mixture.new_candidate((column0, column1), (row0, row1), spacing=spacing)
    for number in share:
        fresh.know(number, mixture.model.log_likelihood(mixture.open[number].detection, fresh.points_m))
    return fresh


def _retold(mixture: "Mixture", candidate: Candidate, share: dict[int, float]) -> Candidate:
    """A new candidate, on the usual points, that claims these shares."""
    claimed = {number: part for number, part in share.items() if part > 0.0}
    fresh = _fresh(mixture, candidate, claimed, spacing=1.0)
    for number, part in claimed.items():
        fresh.set_share(number, part)
    fresh.prune()
    return fresh


def _alike(blank: Candidate) -> Candidate:
    """A copy of an empty candidate that shares its arrays but claims for itself."""
    other = copy.copy(blank)
    other.logs, other.share, other.evidence = dict(blank.logs), dict(blank.share), blank.evidence.copy()
    return other


def _two(mixture: "Mixture", blank: Candidate, share: dict[int, float]) -> list[list[Candidate]]:
    """Two sources, from first guesses that divide the detections across the line they spread on most."""
    alone = []
    for log in blank.logs.values():
        weight = np.exp(mixture.model.marginal(log))
        alone.append((weight / weight.sum()) @ blank.points_m)
    spread = np.array(alone) - np.mean(alone, axis=0)
    axis = np.linalg.svd(spread, full_matrices=False)[2][0]
    stories = []
    for turn_rad in (0.0, np.pi / 3, -np.pi / 3):
        cos, sin = np.cos(turn_rad), np.sin(turn_rad)
        along = spread @ np.array([cos * axis[0] - sin * axis[1], sin * axis[0] + cos * axis[1]])
        order = np.argsort(np.argsort(along, kind="stable"), kind="stable")
        stories.append(_divide(mixture, blank, share, order * 2 < len(share)))
    stories.append(_divide(mixture, blank, share, _best_two_places(mixture, blank, share)))
    return [pair for pair in stories if min(part.receptions for part in pair) >= 1.0]


def _best_two_places(mixture: "Mixture", blank: Candidate, share: dict[int, float]) -> NDArray[np.bool_]:
    """(detections,) whether each was rather sent from the first of the two places and powers that explain all best.

    Two sources a cell or two apart are no line that detections spread on: what tells them apart is how strong each
    transmission was. Coordinate ascent over all places and known powers, from the best single one.
    """
    known = mixture.model.n_known
    logs = np.array([blank.logs[number][:known].ravel() for number in share])
    weight = np.array(list(share.values()))
    like = np.exp(logs - logs.max(axis=1, keepdims=True)) + 1e-12
    first = second = int(np.argmax(weight @ np.log(like)))
    for _ in range(PLACE_ROUNDS):
        first, second = second, int(np.argmax(weight @ np.log(like + like[:, second, None])))
    return np.asarray(like[:, first] > like[:, second])


def _divide(
    mixture: "Mixture", blank: Candidate, share: dict[int, float], lean: NDArray[np.bool_]
) -> list[Candidate]:
    """Two candidates that settle between them who sent what, from a first guess."""
    pair = [_alike(blank), _alike(blank)]
    for first_more, (number, whole) in zip(lean, share.items(), strict=True):
        first = 0.9 if first_more else 0.1
        pair[0].set_share(number, first * whole)
        pair[1].set_share(number, (1.0 - first) * whole)
    for _ in range(8):
        for part in pair:
            part.prune()
        logs = [part.log_posterior() for part in pair]
        active = [active_entries(log) for log in logs]
        exposure = [part.mean_exposure_s(part.posterior()) for part in pair]
        moved = 0.0
        for number, whole in share.items():
            terms = np.array(
                [
                    np.log(
                        (RATE_SHAPE + max(0.0, c.receptions - c.share[number]))
                        / (mixture.rate_prior_s + seen)
                    )
                    + c.log_predictive(number, log, entries)
                    for c, log, entries, seen in zip(pair, logs, active, exposure, strict=True)
                ]
            )
            shares = whole * np.exp(terms - log_sum(terms))
            for index, part in enumerate(pair):
                change = float(shares[index]) - part.share[number]
                moved += abs(change)
                part.set_share(number, float(shares[index]))
                logs[index] = logs[index] + change * part.logs[number]
        if moved < 0.05:
            break
    return pair


def _score(story: list[Candidate], share: dict[int, float]) -> float:
    """Lower bound of the log evidence of a story that shares out the same detections."""
    total = math.fsum(candidate.log_evidence() for candidate in story)
    for number, part in share.items():
        parts = np.array([candidate.share.get(number, 0.0) for candidate in story]) / part
        total -= part * float((parts * np.log(np.maximum(parts, 1e-12))).sum())
    return total
