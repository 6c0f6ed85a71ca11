"""A candidate that did not last is not tried again at every packet."""

from dataclasses import replace

import numpy as np

from fieldkit.engine.belief.intensity import births
from fieldkit.engine.belief.intensity.belief import IntensityBelief
from fieldkit.messages import Detection, Listening
from mission.lab.bench import settings

S = 1_000_000_000


def heard_once() -> IntensityBelief:
    """Two robots heard a packet, and what it gave birth to is gone again."""
    engine = replace(settings(cells=50, pairs=1, prior_rule="em", sensing="levels"), spread=None)
    belief = IntensityBelief(engine)
    at = np.array([[5.0, 5.0], [6.0, 5.0]])
    belief.listen(Listening(0, S, engine.robots, at))
    rss = engine.antenna.mean_rss_dbm(np.array([1.0, 1.2]))
    belief.detect(Detection(S, engine.robots, at, np.zeros(2), np.round(rss), np.zeros(2, dtype=bool)))
    for candidate in list(belief.candidates):
        belief.mixture.remove(candidate)
    mixture = belief.mixture
    mixture.stillborn.clear()
    mixture.explained = {number: stored.log_clutter for number, stored in mixture.open.items()}
    return belief


def test_one_that_did_not_last_is_tried_again_when_much_more_was_heard() -> None:
    mixture = heard_once().mixture
    mixture.next_detection = 100
    assert births.birth(mixture)
    (born,) = mixture.born.values()
    mixture.remove(mixture.candidates[0])
    births.remember_births(mixture)
    assert mixture.stillborn == [born] and born.detections == 100
    assert not births.birth(mixture)
    mixture.next_detection = 126
    assert births.birth(mixture)


def test_one_that_did_not_last_is_tried_again_at_much_better_odds() -> None:
    mixture = heard_once().mixture
    assert births.birth(mixture)
    (born,) = mixture.born.values()
    mixture.remove(mixture.candidates[0])
    mixture.stillborn = [replace(born, odds=born.odds / 3.1, detections=10**9)]
    assert births.birth(mixture)
