"""Stone Soup's bootstrap particle filter over (east, north, power): what our own estimates are compared with.

Stone Soup is no dependency of fieldkit: import this module where it is used. Raises `ImportError` without it.
"""

from collections.abc import Callable
from datetime import datetime, timedelta
from typing import Any

import numpy as np
from stonesoup.models.measurement.base import MeasurementModel
from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, RandomWalk
from stonesoup.predictor.particle import ParticlePredictor
from stonesoup.resampler.particle import SystematicResampler
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.state import ParticleState, StateVector, StateVectors
from stonesoup.updater.particle import ParticleUpdater

from fieldkit.messages import FloatArray

LogLikelihood = Callable[[FloatArray], FloatArray]
"""Of what was measured, in the log, for states (3, n): east, north, power. (n,)"""


class _Measured(MeasurementModel):  # type: ignore[misc]  # the library is not typed
    """What the filter asks of a measurement: how probable it is in each state."""

    ndim_state, ndim_meas, mapping = 3, 1, (0, 1, 2)
    log_likelihood: LogLikelihood

    def function(self, state: Any, noise: bool = False, **_: Any) -> Any:
        raise NotImplementedError("a particle filter predicts no measurement")

    def rvs(self, num_samples: int = 1, **_: Any) -> Any:
        raise NotImplementedError("a particle filter draws no measurement")

    def pdf(self, state1: Any, state2: Any, **_: Any) -> Any:
        return np.exp(self.logpdf(state1, state2))

    def logpdf(self, state1: Any, state2: Any, **_: Any) -> Any:
        return self.log_likelihood(np.asarray(state2.state_vector, dtype=float))


class BootstrapFilter:
    """A cloud (3, n) that wanders with `step_m2` and `step_db2` of variance between measurements."""

    def __init__(self, cloud: FloatArray, step_m2: float, step_db2: float, seed: int) -> None:
        self.at = datetime(2000, 1, 1)
        weight = np.full(cloud.shape[1], 1.0 / cloud.shape[1])
        self.state = ParticleState(StateVectors(cloud), weight=weight, timestamp=self.at)
        walk = [RandomWalk(step_m2), RandomWalk(step_m2), RandomWalk(step_db2)]
        self.predictor = ParticlePredictor(CombinedLinearGaussianTransitionModel(walk))
        self.updater = ParticleUpdater(None, SystematicResampler())
        np.random.seed(seed)  # noqa: NPY002  Stone Soup draws from numpy's global generator

    def update(self, log_likelihood: LogLikelihood) -> None:
        """Take in one measurement."""
        self.at += timedelta(seconds=1)
        model = _Measured()
        model.log_likelihood = log_likelihood
        measured = Detection(StateVector([0.0]), timestamp=self.at, measurement_model=model)
        prediction = self.predictor.predict(self.state, timestamp=self.at)
        self.state = self.updater.update(SingleHypothesis(prediction, measured))

    @property
    def cloud(self) -> FloatArray:
        """(3, n) states."""
        return np.asarray(self.state.state_vector, dtype=float)

    @property
    def weight(self) -> FloatArray:
        """(n,) of each state."""
        return np.asarray(self.state.weight, dtype=float)

    @property
    def mean(self) -> FloatArray:
        """(3,)"""
        return np.asarray(self.state.mean, dtype=float).ravel()
