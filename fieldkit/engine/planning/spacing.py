"""How far apart the two robots of a pair drive: the distance that leaves least entropy (PRWA eq 24 to 26)."""

import numpy as np

from fieldkit.engine.likelihood import pairwise_loops
from fieldkit.engine.likelihood.pairwise import RANGE_DB, STEP_DB, tables
from fieldkit.engine.planning import spacing_loops
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import FloatArray


def best_spacing_m(
    settings: EngineSettings,
    cells_m: FloatArray,
    presence: FloatArray,
    prior: FloatArray,
    centres_m: FloatArray,
    across: FloatArray,
    spacings_m: FloatArray,
    *,
    normalised: bool = False,
) -> float:
    """The argmin of eq 26's sum over the candidate spacings (d,); see `spacing_entropies`.

    (Algorithm 2 looks for the largest single H; the text around eq 26 and the goal ask for the smallest sum, which is
    what is done.)
    """
    entropy = spacing_entropies(
        settings, cells_m, presence, prior, centres_m, across, spacings_m, normalised=normalised
    )
    return float(spacings_m[int(np.argmin(entropy))])


def spacing_entropies(
    settings: EngineSettings,
    cells_m: FloatArray,
    presence: FloatArray,
    prior: FloatArray,
    centres_m: FloatArray,
    across: FloatArray,
    spacings_m: FloatArray,
    *,
    normalised: bool,
) -> FloatArray:
    """(d,) eq 26's sum for each of the spacings (d,).

    `cells_m` (n, 2), `presence` and `prior` (n,) of the cluster; `centres_m` (t, 2) of the pair while on the
    ridge and `across` (t, 2) unit vectors along which it is spread. Eq 25 treats P(C_i) as if it were a
    distribution; kept as printed unless `normalised`.
    """
    e11, e10 = (
        pairwise_loops.lines(np.arange(float(len(table))), np.exp(table))
        for table in tables(settings.antenna.sigma_db)
    )
    levels = settings.antenna.power_at_1m_dbm + np.array(settings.power_levels_db)
    entropy = []
    for spacing in spacings_m:
        half = 0.5 * spacing * across
        pairs = np.ascontiguousarray(np.stack([centres_m - half, centres_m + half], axis=1))
        entropy.append(
            spacing_loops.spacing_entropy(
                np.ascontiguousarray(cells_m),
                np.ascontiguousarray(presence),
                np.ascontiguousarray(prior),
                pairs,
                levels,
                settings.antenna.law,
                settings.antenna.threshold_dbm,
                settings.grid.cell_m / 2,
                e11,
                e10,
                RANGE_DB,
                1.0 / STEP_DB,
                normalised,
            )
        )
    return np.array(entropy)
