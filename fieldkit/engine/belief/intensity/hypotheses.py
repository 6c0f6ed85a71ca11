"""Estimating a candidate afresh, as one source and as two, and keeping the hypothesis with more evidence.

Points dropped early and responsibilities that vouch for each other can hold a candidate in a wrong place, or hold
two near sources together: sweeps alone do not get out of that.
"""

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fieldkit.engine.belief.intensity import loops
from fieldkit.engine.belief.intensity.births import know_all, new_candidate
from fieldkit.engine.belief.intensity.candidate import Candidate, TwoSource
from fieldkit.engine.belief.intensity.responsibilities import (
    claim_what_moved,
    entries_that_count,
    known_responsibilities,
)
from fieldkit.engine.belief.intensity.shadowed import trust
from fieldkit.engine.belief.intensity.silence import note_heard
from fieldkit.engine.likelihood.places import redundancy
from fieldkit.messages import FloatArray

if TYPE_CHECKING:
    from fieldkit.engine.belief.intensity.mixture import Mixture


def revise(mixture: "Mixture") -> bool | None:
    """Re-estimate a candidate, as one source and as two; whether another hypothesis was better.

    One candidate a call, None where no hypothesis is due. An inconsistent candidate is looked at again soon,
    others ever more rarely. One and two are compared on a point a cell; the better one is then estimated on the usual
    points.
    """
    for candidate in mixture.candidates:
        due = mixture.revise_at.setdefault(candidate.ident, mixture.tuning.first_look)
        if candidate.receptions >= due and any(
            responsibility > 0.05 for responsibility in candidate.responsibility.values()
        ):
            return _revise(mixture, candidate)
    return None


def _revise(mixture: "Mixture", candidate: Candidate) -> bool:
    count, inconsistent = candidate.receptions, candidate.state == "inconsistent"
    whole = _re_estimated_from(mixture, candidate)
    responsibility = _discounted(mixture, whole)
    blank = _fresh(mixture, candidate, responsibility, most=mixture.tuning.compared_points)
    kept = _with_frozen(mixture, candidate, responsibility) if candidate.frozen_receptions > 0.0 else None
    single = (kept or blank).copy()
    single.set_responsibilities(list(responsibility), list(responsibility.values()))
    pairs = [] if candidate.name else _two(mixture, blank, kept, responsibility)
    scores = [_score(pair, responsibility) for pair in pairs]
    odds_nats = max(scores, default=-np.inf) - _score([single], responsibility)
    undecided = odds_nats > mixture.tuning.undecided_nats
    candidate.two_source = None
    if pairs:
        places = np.array([_mean(part) for part in pairs[int(np.argmax(scores))]])
        candidate.two_source = TwoSource(float(1.0 / (1.0 + np.exp(-odds_nats))), places, undecided)
    mixture.revise_at[candidate.ident] = _next_look(mixture, count, odds_nats, inconsistent)
    if odds_nats > mixture.tuning.better_nats:
        shares = [
            _undone(part.responsibility, responsibility, whole) for part in pairs[int(np.argmax(scores))]
        ]
        parts = [_re_estimated(mixture, candidate, share) for share in shares[1 if kept else 0 :]]
        if kept:
            parts.insert(0, _claiming(candidate, shares[0]))
    elif kept:
        return False  # what is marginalised leaves no other place to it
    else:
        moved = np.abs(_mean(single) - mixture.summary(candidate).mean_m).max() > mixture.field.cell_m
        if not (moved or inconsistent):
            return False
        parts = [_re_estimated(mixture, candidate, whole)]
        if _score(parts, whole) < _score([candidate], whole) + mixture.tuning.better_nats:
            return False
    _replace(mixture, candidate, parts)
    return True


def _replace(mixture: "Mixture", candidate: Candidate, parts: list[Candidate]) -> None:
    """Put the parts of the better hypothesis in the candidate's place; the first one goes by its name."""
    mixture.remove(candidate)
    parts[0].ident = candidate.ident
    parts[0].state = candidate.state
    parts[0].name = candidate.name
    if len(parts) == 1:
        parts[0].first_ns, parts[0].last_ns = candidate.first_ns, candidate.last_ns
        parts[0].exposure_then_s, parts[0].listened_at = (
            candidate.exposure_then_s,
            dict(candidate.listened_at),
        )
    mixture.candidates += parts
    for revised in parts:
        know_all(mixture, revised)
        note_heard(mixture, revised)


def _with_frozen(mixture: "Mixture", candidate: Candidate, responsibility: dict[int, float]) -> Candidate:
    """The candidate with nothing but its marginalised detections, which knows the others as `_fresh` does.

    It stays on its own points. What is marginalised is known there alone, and is so sharp that it would rule out
    every point of a coarser cloud.
    """
    kept = candidate.with_frozen_alone()
    for number in responsibility:
        kept.know(number, mixture.model.log_likelihood(mixture.open[number].detection, kept.points_m))
    return kept


def _claiming(candidate: Candidate, share: dict[int, float]) -> Candidate:
    """The candidate with this share of its open detections."""
    part = candidate.copy()
    part.two_source = None
    part.set_responsibilities(
        list(part.responsibility), [share.get(number, 0.0) for number in part.responsibility]
    )
    return part


def _undone(
    part: dict[int, float], discounted: dict[int, float], whole: dict[int, float]
) -> dict[int, float]:
    """A part's responsibilities as they are without the discount for neighbours."""
    return {
        number: responsibility * whole[number] / discounted[number] for number, responsibility in part.items()
    }


def _next_look(mixture: "Mixture", count: float, odds_nats: float, inconsistent: bool) -> float:
    """Receptions at which to look again: soon where two are as likely as one, late where they are not at all."""
    if odds_nats > mixture.tuning.undecided_nats:
        return count + 1.9
    if inconsistent:
        return max(count + 0.9, 1.1 * count)
    if odds_nats >= mixture.tuning.clear_nats:
        return 1.4 * count
    return (4.0 if count > mixture.tuning.re_estimated_from else 2.0) * count


def _re_estimated_from(mixture: "Mixture", candidate: Candidate) -> dict[int, float]:
    """Responsibilities of the detections a hypothesis is re-estimated from: of very many some, evenly over time."""
    claimed = [
        (number, responsibility)
        for number, responsibility in candidate.responsibility.items()
        if responsibility > 0.05
    ]
    return dict(claimed[:: -(-len(claimed) // mixture.tuning.re_estimated_from) or 1])


def _discounted(mixture: "Mixture", responsibility: dict[int, float]) -> dict[int, float]:
    """The same responsibilities, each discounted for its neighbours, as when none is conditioned on the others."""
    spread = mixture.settings.spread
    if mixture.places is None or spread is None:
        return responsibility
    weights = redundancy([mixture.open[number].near_m for number in responsibility], spread)
    return {
        number: part * float(each)
        for (number, part), each in zip(responsibility.items(), weights, strict=True)
    }


def _mean(candidate: Candidate) -> FloatArray:
    return np.asarray(candidate.posterior().sum(axis=0) @ candidate.points_m)


def _fresh(
    mixture: "Mixture", candidate: Candidate, responsibility: dict[int, float], *, most: int
) -> Candidate:
    """An empty candidate whose cloud covers wherever the given detections may have come from.

    All the ground that the candidate holds for possible, and some round it: a posterior that is cut off claims a
    certainty that nobody has.
    """
    centre = mixture.summary(candidate).mean_m
    half = min(0.75 * mixture.model.reach_m, mixture.tuning.re_estimated_cells * mixture.field.cell_m)
    whole = np.vstack([centre - half, centre + half, candidate.points_m])
    row0, row1, column0, column1 = mixture.grid.box_around(whole, 0.0)
    fresh = new_candidate(mixture, (column0, column1), (row0, row1), spacing=1.0, most=most)
    trust(mixture, fresh, responsibility)
    fresh.expose(fresh.exposure_s)
    for number in responsibility:
        fresh.know(number, mixture.model.log_likelihood(mixture.open[number].detection, fresh.points_m))
    return fresh


def _re_estimated(mixture: "Mixture", candidate: Candidate, responsibility: dict[int, float]) -> Candidate:
    """A new candidate, on the usual points, that claims these responsibilities."""
    claimed = {number: part for number, part in responsibility.items() if part > 0.0}
    fresh = _fresh(mixture, candidate, claimed, most=mixture.tuning.most_points)
    if mixture.places is None:
        fresh.set_responsibilities(list(claimed), list(claimed.values()))
    else:
        # Each is conditioned on those claimed before it: one after another, over again with the right ones.
        for number, part in claimed.items():
            fresh.know(number, mixture.log_likelihood(fresh, number))
            fresh.set_responsibility(number, part)
    fresh.prune()
    return fresh


def _two(
    mixture: "Mixture", blank: Candidate, kept: Candidate | None, responsibility: dict[int, float]
) -> list[list[Candidate]]:
    """Two sources, from first guesses that divide the detections across the line they spread on most.

    Where something is marginalised the first of the two is who sent it: `kept`, which takes either side of the line.
    """
    alone = []
    for row in blank.logs.values():
        weight = np.exp(mixture.model.marginal(row.array))
        alone.append((weight / weight.sum()) @ blank.points_m)
    spread = np.array(alone) - np.mean(alone, axis=0)
    axis = np.linalg.svd(spread, full_matrices=False)[2][0]
    leans = []
    for turn_rad in (0.0, np.pi / 3, -np.pi / 3):
        cos, sin = np.cos(turn_rad), np.sin(turn_rad)
        along = spread @ np.array([cos * axis[0] - sin * axis[1], sin * axis[0] + cos * axis[1]])
        order = np.argsort(np.argsort(along, kind="stable"), kind="stable")
        leans.append(order * 2 < len(responsibility))
    leans.append(_best_two_places(mixture, blank, responsibility))
    if kept:
        leans += [~lean for lean in leans]
    hypotheses = [
        _divide(mixture, [(kept or blank).copy(), blank.copy()], responsibility, lean) for lean in leans
    ]
    return [pair for pair in hypotheses if min(part.receptions for part in pair) >= 1.0]


def _best_two_places(
    mixture: "Mixture", blank: Candidate, responsibility: dict[int, float]
) -> NDArray[np.bool_]:
    """(detections,) whether each was rather sent from the first of the two places and powers that explain all best.

    Two sources a cell or two apart are no line that detections spread on: what separates them is how strong each
    transmission was. Coordinate ascent over all places and known powers, from the best single one.
    """
    known = mixture.model.n_known
    logs = np.array([blank.logs[number].array[:known].ravel() for number in responsibility])
    weight = np.array(list(responsibility.values()))
    like = np.exp(logs - logs.max(axis=1, keepdims=True)) + 1e-12
    first = second = int(np.argmax(weight @ np.log(like)))
    for _ in range(mixture.tuning.place_rounds):
        first, second = second, int(np.argmax(weight @ np.log(like + like[:, second, None])))
    return np.asarray(logs[:, first] > logs[:, second])


def _divide(
    mixture: "Mixture", pair: list[Candidate], responsibility: dict[int, float], lean: NDArray[np.bool_]
) -> list[Candidate]:
    """Two candidates that settle between them who sent what, from a first guess."""
    numbers, whole = list(responsibility), np.array(list(responsibility.values()))
    first = np.where(lean, 0.9, 0.1) * whole
    pair[0].set_responsibilities(numbers, first.tolist())
    pair[1].set_responsibilities(numbers, (whole - first).tolist())
    nobody = np.full(whole.size, -1e300)
    for _ in range(8):
        for part in pair:
            part.prune()
        rows, parts = known_responsibilities(pair, numbers)
        active, start, post, log_exposure = entries_that_count(pair)
        before = parts.copy()
        loops.attribute(
            mixture.arena.values,
            rows,
            parts,
            whole,
            active,
            start,
            post,
            log_exposure,
            np.array([part.receptions for part in pair]),
            np.array([part.mean_exposure_s(part.posterior()) for part in pair]),
            mixture.tuning.rate_shape,
            mixture.rate_prior_s,
            nobody,
            nobody,
            False,
            np.empty(whole.size),
            np.empty(whole.size),
        )
        claim_what_moved(pair, numbers, before, parts)
        if np.abs(parts - before).sum() < 0.05:
            break
    return pair


def _score(hypothesis: list[Candidate], responsibility: dict[int, float]) -> float:
    """Lower bound of the log evidence of a hypothesis that attributes the same detections."""
    total = math.fsum(candidate.log_evidence() for candidate in hypothesis)
    for number, part in responsibility.items():
        parts = np.array([candidate.responsibility.get(number, 0.0) for candidate in hypothesis]) / part
        total -= part * float((parts * np.log(np.maximum(parts, 1e-12))).sum())
    return total
