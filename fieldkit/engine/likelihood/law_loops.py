"""The law of `channel.law` for compiled loops: the same functions, which cost no call there."""

from fieldkit.channel import law
from fieldkit.engine.compiled import njit

loss_db = njit(cache=True, nogil=True, inline="always")(law.loss_db)
slope_db = njit(cache=True, nogil=True, inline="always")(law.slope_db)
as_far_m2 = njit(cache=True, nogil=True, inline="always")(law.as_far_m2)
