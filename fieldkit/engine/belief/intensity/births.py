"""Where candidates come from: a place where one more source explains what was heard, and points that get finer."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from fieldkit.engine.belief.intensity.candidate import Candidate
from fieldkit.engine.belief.intensity.shadowed import trust
from fieldkit.engine.belief.intensity.unknown import another_source

if TYPE_CHECKING:
    from fieldkit.engine.belief.intensity.mixture import Mixture, OpenDetection

MOST_STILLBORN = 100
HARDLY = 1e-4
"""A detection that a newborn explains so much worse than others do is put before it once it has lasted."""
AGAIN_AFTER = 1.25
"""Times the detections after which a candidate that did not last is tried again."""


@dataclass(frozen=True, slots=True)
class Born:
    """Where a candidate was tried, at what odds, and how many detections there were."""

    at_m: tuple[float, float]
    odds: float
    detections: int


def birth(mixture: "Mixture") -> Candidate | None:
    """A candidate where one more source explains what was heard better than none; None where none does."""
    expected = another_source(mixture)
    prior = mixture.settings.expected_sources * mixture.ground.sources_a_cell / mixture.model.n_known
    place = np.where(expected > prior, expected, 0.0).sum(axis=0)
    for tried in mixture.stillborn:
        # What did not last is tried again when there is much more to be said for it.
        far2 = (mixture.grid.east_m[None, :] - tried.at_m[0]) ** 2
        far2 = far2 + (mixture.grid.north_m[:, None] - tried.at_m[1]) ** 2
        near_it = far2 <= (mixture.model.reach_m / 2.0) ** 2
        if place[near_it].sum() < mixture.tuning.again_odds * tried.odds and not _much_newer(mixture, tried):
            place[near_it] = 0.0
    if place.sum() < mixture.tuning.birth_odds:
        return None
    row, column = np.unravel_index(int(np.argmax(place)), place.shape)
    level = int(np.argmax(expected[:, row, column]))
    near = place > 1e-4 * place.max()
    reach = int(np.ceil(mixture.model.reach_m / mixture.grid.cell_m))
    south, west = max(0, int(row) - reach), max(0, int(column) - reach)
    rows = np.nonzero(near[south : int(row) + reach + 1].any(axis=1))[0] + south
    columns = np.nonzero(near[:, west : int(column) + reach + 1].any(axis=0))[0] + west
    candidate = new_candidate(
        mixture,
        (int(columns.min()), int(columns.max()) + 1),
        (int(rows.min()), int(rows.max()) + 1),
        spacing=1.0,
    )
    rate = mixture.settings.reference_rate_hz
    for number, stored in mixture.open.items():
        if number in mixture.named or not mixture.in_reach(candidate, stored):
            continue
        row0, row1, column0, column1 = stored.box
        if not (row0 <= row < row1 and column0 <= column < column1):
            continue
        like = stored.like.at(level, int((row - row0) * (column1 - column0) + column - column0))
        ratio = rate * like * np.exp(stored.log_scale - mixture.explained[number])
        if ratio < HARDLY:
            continue
        # With place noise each is conditioned on those claimed before it: as independent witnesses they would
        # rule out ground that is not to be had back.
        candidate.know(number, mixture.log_likelihood(candidate, number))
        candidate.set_responsibility(number, float(ratio / (1.0 + ratio)))
    if candidate.receptions < mixture.tuning.death_receptions:
        return None
    trust(mixture, candidate, mixture.claimed_by(candidate))
    candidate.expose(candidate.exposure_s)
    for number, responsibility in candidate.responsibility.items():
        for other in mixture.candidates:
            if responsibility > 0.0 and number in other.responsibility:
                other.set_responsibility(number, other.responsibility[number] * (1.0 - responsibility))
    mixture.forget_summaries()
    mixture.candidates.append(candidate)
    at = float(mixture.grid.east_m[column]), float(mixture.grid.north_m[row])
    mixture.born[candidate.ident] = Born(at, float(place.sum()), mixture.next_detection)
    return candidate


def _much_newer(mixture: "Mixture", tried: Born) -> bool:
    """Whether so much was heard since that it is worth another try.

    Under place noise detections near each other are no new witnesses: only the odds count.
    """
    return mixture.places is None and mixture.next_detection >= AGAIN_AFTER * tried.detections


def remember_births(mixture: "Mixture") -> None:
    """Where a candidate was tried that did not last: else every detection would try again."""
    lived = {candidate.ident for candidate in mixture.candidates}
    gone = [each for ident, each in mixture.born.items() if ident not in lived]
    for candidate in mixture.candidates:
        if candidate.ident in mixture.born:
            know_all(mixture, candidate)
    mixture.stillborn = [*mixture.stillborn, *gone][-MOST_STILLBORN:]
    mixture.born.clear()


def new_candidate(
    mixture: "Mixture",
    columns: tuple[int, int],
    rows: tuple[int, int],
    *,
    spacing: float | None = None,
    most: int | None = None,
) -> Candidate:
    """An empty candidate whose cloud covers these cells (half open) and one more all round.

    `spacing` of its points, in cells: whole, or one over a whole number. Where that makes more than `most`
    (the tuning's `most_points`) of them they stand further apart, until the candidate is refined.
    """
    spacing, most = spacing or mixture.tuning.fine_cells, most or mixture.tuning.most_points
    columns = (max(0, columns[0] - 1), min(mixture.grid.n_east, columns[1] + 1))
    rows = (max(0, rows[0] - 1), min(mixture.grid.n_north, rows[1] + 1))
    while (columns[1] - columns[0]) * (rows[1] - rows[0]) > most * spacing**2:
        spacing *= 2.0
    fine = mixture.grid.cell_m * spacing
    east = (np.arange(math.floor(columns[0] / spacing), math.ceil(columns[1] / spacing)) + 0.5) * fine
    north = (np.arange(math.floor(rows[0] / spacing), math.ceil(rows[1] / spacing)) + 0.5) * fine
    east = east[east < mixture.grid.n_east * mixture.grid.cell_m]
    north = north[north < mixture.grid.n_north * mixture.grid.cell_m]
    east, north = east + mixture.grid.west_m, north + mixture.grid.south_m
    points = np.column_stack([np.tile(east, north.size), np.repeat(north, east.size)])
    density = mixture.settings.expected_sources * mixture.ground.sources_a_cell * spacing**2
    prior = np.repeat(mixture.model.log_prior[:, None] + np.log(density), points.shape[0], axis=1)
    return Candidate(
        mixture.next_ident(),
        points,
        prior,
        mixture.rate_prior_s,
        mixture.exposure_at(points),
        fine,
        mixture.arena,
        mixture.tuning,
    )


def is_coarse(mixture: "Mixture", candidate: Candidate) -> bool:
    """Whether a candidate has become small enough for its points to be refined, and they are not yet.

    Where hearing is sharper than their spacing that pays early: in the trust study, refined from 100 points on, four
    sources took 793 s on average of 16 seeds, from 300 on 678 s.
    """
    tuning, spacing_m = mixture.tuning, candidate.spacing_m
    few = tuning.blurred_points if spacing_m <= mixture.ground.blurred_m else tuning.refine_points
    return spacing_m > 1.01 * tuning.fine_cells * mixture.field.cell_m and candidate.points_m.shape[0] <= few


def refine(mixture: "Mixture", candidate: Candidate) -> None:
    """Give a candidate that has become small four points for each of its own; its responsibilities stay."""
    half = candidate.spacing_m / 2
    corners = np.array([[-0.5, -0.5], [0.5, -0.5], [-0.5, 0.5], [0.5, 0.5]]) * half
    candidate.points_m = np.ascontiguousarray((candidate.points_m[:, None, :] + corners).reshape(-1, 2))
    candidate.log_prior = np.repeat(candidate.log_prior - np.log(4.0), 4, axis=1)
    # What is frozen is known only on the old points.
    candidate.evidence = np.repeat(candidate.frozen(), 4, axis=1)
    candidate.spacing_m = half
    candidate.expose(mixture.exposure_at(candidate.points_m))
    for number, responsibility in candidate.responsibility.items():
        log = mixture.log_likelihood(candidate, number)
        candidate.know(number, log)
        candidate.evidence += responsibility * log


def know_all(mixture: "Mixture", candidate: Candidate) -> None:
    """Have a candidate know all open detections that it may have sent."""
    for number, other in mixture.open.items():
        if number in candidate.logs:
            continue
        if candidate.name and other.detection.sender == candidate.name:
            candidate.know(number, mixture.log_likelihood(candidate, number))
            candidate.set_responsibility(number, 1.0)
        elif not candidate.name and number not in mixture.named and mixture.in_reach(candidate, other):
            candidate.know(number, mixture.log_likelihood(candidate, number))


def claim_by_name(mixture: "Mixture", number: int, stored: "OpenDetection", name: str) -> None:
    """A detection that names its sender belongs to that sender, who may be new, for certain."""
    sender = next((each for each in mixture.candidates if each.name == name), None)
    if sender is None:
        row0, row1, column0, column1 = stored.box
        sender = new_candidate(mixture, (column0, column1), (row0, row1), spacing=1.0)
        sender.name = name
        mixture.candidates.append(sender)
    sender.know(number, mixture.log_likelihood(sender, number))
    sender.set_responsibility(number, 1.0)
    mixture.unclaimed[number] = 0.0
    mixture.explained[number] = 50.0  # nobody else needs to explain it
    mixture.forget_summary(sender)
