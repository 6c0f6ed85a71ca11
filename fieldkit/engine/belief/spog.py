"""The papers' belief: a spatiotemporal probability occupancy grid (PRWA eq 1 and 2, Algorithm 1).

P(C_i^1) is the probability that cell i sent the present transmission, P(C_i) that it holds a source:
P1_i = L_i pi_i / sum L pi, then P_i <- P1_i + P_i (1 - P1_i), in logs: log(1 - P) += log(1 - P1).

The prior pi of the next transmission is where the printed recursion goes wrong (it feeds P1 back, which multiplies
the likelihoods of different sources' transmissions), so the rule is chosen:

- `literal`: pi <- P1, eq 2 as printed; right for one source;
- `uniform`: pi = 1/n;
- `dirichlet`: pi_i = (alpha/n + sum of P1_i so far) / (alpha + K), alpha = 5;
- `em` (default): pi are the mixture weights of all stored events, re-attributed at each one; P can fall again.

Silence is not evidence here: that is what the intensity belief adds.
"""

import hashlib
from collections.abc import Callable, Sequence

import numpy as np
from scipy import ndimage
from scipy.special import logsumexp

from fieldkit.engine.belief import spog_loops
from fieldkit.engine.likelihood.directional import DirectionalModel
from fieldkit.engine.likelihood.levels import LevelsModel
from fieldkit.engine.likelihood.pairwise import PairwiseModel
from fieldkit.engine.settings import EngineSettings
from fieldkit.errors import ConfigError
from fieldkit.messages import Detection, FloatArray, Listening, SourceEstimate

RULES = ("literal", "uniform", "dirichlet", "em")
EIGHT = np.ones((3, 3), dtype=int)
"""Cells that touch at a corner are one component."""


class SpogBelief:
    """See the module. Arrays over the grid are flat inside, (n_north, n_east) outside."""

    def __init__(self, settings: EngineSettings) -> None:
        if settings.prior_rule not in RULES:
            raise ConfigError(f"prior_rule: expected one of {', '.join(RULES)}, got {settings.prior_rule!r}")
        self.settings, self._tuning = settings, settings.tuning.paper_beliefs
        self.grid = settings.grid
        n = self.grid.n_cells
        centres = self.grid.centres_m
        if settings.sensing == "directional":
            directional = DirectionalModel(
                settings.antenna,
                settings.power_levels_db,
                centres,
                self.grid.cell_m / 2,
                settings.directional_form,
            )
            self._likelihood: Callable[[Detection], FloatArray] = directional.log_likelihood
        elif settings.sensing == "pairwise":
            pairwise = PairwiseModel(settings.antenna, centres, self.grid.cell_m / 2)
            self._likelihood = pairwise.log_likelihood
        else:
            levels = LevelsModel(settings.antenna, settings.power_levels_db, self.grid.cell_m / np.sqrt(12.0))
            known = levels.n_known
            self._likelihood = lambda d: np.asarray(
                logsumexp(levels.log_likelihood(d, centres)[:known], axis=0) - np.log(known)
            )
        self.log_prior = np.full(n, -np.log(n))
        """(n,) log pi of the next transmission."""
        self.log_absent = np.zeros(n)
        """(n,) log(1 - P(C_i))."""
        self._sum_p1 = np.zeros(n)
        self._events = 0
        self._likelihoods = np.empty((0, n))
        """`em`: (room, n) likelihoods of the events that are still re-attributed, each scaled to a maximum of 1."""
        self._stored = 0
        self._settled = np.zeros(n)
        """`em`: sum of log(1 - r) of events no longer re-attributed."""
        self._settled_p1 = np.zeros(n)

    def detect(self, detection: Detection) -> None:
        """Algorithm 1 for one transmission."""
        self.update(self._likelihood(detection))

    def update(self, log_likelihood: FloatArray) -> None:
        """Take in the log-likelihood (n,) of one transmission over the cells; constants do not matter."""
        n = self.grid.n_cells
        self._events += 1
        if self.settings.prior_rule == "em":
            self._reattribute(log_likelihood)
            return
        log_weight = log_likelihood + self.log_prior
        log_weight -= log_weight.max()
        p1 = np.exp(log_weight)
        total = float(p1.sum())
        spog_loops.add_shares(p1, total, self.log_absent, self._sum_p1)
        match self.settings.prior_rule:
            case "literal":
                log_weight -= np.log(total)
                self.log_prior = log_weight
            case "dirichlet":
                pseudo = self._sum_p1 + self._tuning.dirichlet_alpha / n
                pseudo /= self._tuning.dirichlet_alpha + self._events
                self.log_prior = np.log(pseudo, out=pseudo)
            case _:
                pass  # uniform: as it was

    def _reattribute(self, log_likelihood: FloatArray) -> None:
        """EM over all stored events: pi are the mixture weights, r_ki the share of event k that cell i sent."""
        n = self.grid.n_cells
        if self._stored == len(self._likelihoods):
            grown = np.empty((2 * self._stored + 16, n))
            grown[: self._stored] = self._likelihoods[: self._stored]
            self._likelihoods = grown
        self._likelihoods[self._stored] = np.exp(log_likelihood - log_likelihood.max())
        self._stored += 1
        stored = self._likelihoods[: self._stored]
        pi = np.exp(self.log_prior)
        # One pseudo-event spread over the field keeps every cell alive.
        spog_loops.em_sweeps(
            stored, 1.0 / n + self._settled_p1, 1.0 + self._events, self._tuning.em_sweeps, pi
        )
        self.log_prior = np.log(pi)
        self.log_absent = np.empty(n)
        spog_loops.em_absent(stored, pi, self._settled, self.log_absent)
        if self._stored > self._tuning.max_events:  # the older half keeps its last attribution
            half = self._stored // 2
            share = stored[:half] * pi
            share /= share.sum(axis=1, keepdims=True)
            self._settled = self._settled + np.log1p(-np.minimum(share, 1.0 - 1e-16)).sum(axis=0)
            self._settled_p1 = self._settled_p1 + share.sum(axis=0)
            self._likelihoods[: self._stored - half] = self._likelihoods[half : self._stored].copy()
            self._stored -= half

    def detect_all(self, detections: Sequence[Detection]) -> None:
        """Take in several, one after another."""
        for detection in detections:
            self.detect(detection)

    def reflect(self) -> bool:
        """Nothing is left to think over."""
        return False

    def listen(self, listening: Listening) -> None:
        """Silence says nothing in this belief."""

    def presence(self) -> FloatArray:
        """(n_north, n_east) P(C_i)."""
        return (-np.expm1(self.log_absent)).reshape(self.grid.shape)

    def activity(self) -> FloatArray:
        """(n_north, n_east) the prior of the next transmission, P(C_i^1) before it is heard."""
        result: FloatArray = np.exp(self.log_prior).reshape(self.grid.shape)
        return result

    def sources(self) -> list[SourceEstimate]:
        """The 8-connected clusters of cells with P(C_i) > p_t, which the papers report cell by cell."""
        presence, activity = self.presence(), self.activity()
        labels, count = ndimage.label(presence > self.settings.found_probability, structure=EIGHT)
        estimates = []
        for label in range(1, count + 1):
            rows, columns = np.nonzero(labels == label)
            weight = activity[rows, columns]
            weight = weight / weight.sum()
            place = np.column_stack([self.grid.east_m[columns], self.grid.north_m[rows]])
            mean = weight @ place
            offset = place - mean
            cov = (offset * weight[:, None]).T @ offset + np.eye(2) * self.grid.cell_m**2 / 12.0
            best = int(np.argmax(presence[rows, columns]))
            estimates.append(
                SourceEstimate(
                    ident=int(rows[best] * self.grid.n_east + columns[best]) + 1,
                    east_m=float(mean[0]),
                    north_m=float(mean[1]),
                    cov_m2=cov,
                    region_90=len(rows),
                    receptions=float(activity[rows, columns].sum() * self._events),
                    rate_hz=float("nan"),
                    p_exists=float(presence[rows, columns].max()),
                    p_here=float(presence[rows, columns].max()),
                    state="found",
                )
            )
        return estimates

    def probability_left(self) -> float:
        """Unknown: without silence as evidence, nothing bounds what was not heard."""
        return 1.0

    def digest(self) -> bytes:
        """SHA-256 over prior, presence and count."""
        state = hashlib.sha256(self.log_prior.tobytes())
        state.update(self.log_absent.tobytes())
        state.update(str(self._events).encode())
        return state.digest()
