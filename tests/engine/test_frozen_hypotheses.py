"""One source or two, where most of what is known of them is marginalised: it counts for both hypotheses."""

import numpy as np
from test_silence import Searched

from fieldkit.engine.belief.intensity import hypotheses


def test_a_pair_may_not_leave_what_is_marginalised_behind() -> None:
    """It was all sent from where the candidate is: a hypothesis that has no source there is the worse for it."""
    world = Searched()
    world.go(16, (6.0, 6.0), (6.0, 6.0))
    mixture = world.belief.mixture
    (known,) = [each for each in mixture.candidates if each.receptions > 3.0]
    for number in list(known.responsibility)[:8]:
        known.forget(number)
    assert known.frozen_receptions > 5.0
    there = hypotheses._fresh(mixture, known, known.responsibility, most=400)
    there.set_responsibilities(list(known.responsibility), list(known.responsibility.values()))
    away = there.copy()
    away.points_m = there.points_m + 3.0
    pair = [away, there]
    assert hypotheses._keep_frozen(pair, known) == 1
    assert [part.frozen_receptions for part in pair] == [0.0, known.frozen_receptions]
    astray = [away.copy(), away.copy()]
    kept = [there.copy(), away.copy()]
    for hypothesis in (astray, kept):
        hypotheses._keep_frozen(hypothesis, known)
    assert np.sum([part.log_evidence() for part in kept]) > 5.0 + np.sum(
        [part.log_evidence() for part in astray]
    )


def test_nothing_marginalised_changes_nothing() -> None:
    world = Searched()
    world.go(8, (6.0, 6.0), (6.0, 6.0))
    (known,) = [each for each in world.belief.mixture.candidates if each.receptions > 3.0]
    pair = [known.copy(), known.copy()]
    assert hypotheses._keep_frozen(pair, known) == 0 and pair[0].frozen_receptions == 0.0
