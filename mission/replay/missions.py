"""Which journals are of one mission, where folders hold the runs of several: by how robots' logs begin. Pure.

A robot begins its logs anew with each mission, so two journals that have one beginning of a log in common are of one
mission, and two that have none in common, and another beginning of one log, are of two. Of journals without a word of
each other's robots, which never met, the time decides.
"""

from collections.abc import Sequence

from fieldkit.engine.decentralised.logs import TICK_NS, Entry, Key, Logs

Group = list[int]
"""Places in the list that was given."""


def missions(known: Sequence[Logs], most_apart_ns: int) -> list[Group]:
    """The journals of each mission, the latest mission first. What nobody has observed anything in is with that.

    Missions without a common word are one where neither contradicts the other and one began no longer than
    `most_apart_ns` after the other had ended.
    """
    groups: list[Group] = []
    for number, logs in enumerate(known):
        if not _begins(logs):
            continue
        alike = [group for group in groups if any(_shares(known[each], logs) for each in group)]
        groups = [group for group in groups if group not in alike]
        groups.append([*(each for group in alike for each in group), number])
    groups.sort(key=lambda group: _span_ns(known, group)[::-1], reverse=True)
    parted: list[Group] = []
    for group in groups:
        into = next((each for each in parted if _may_be_one(known, each, group, most_apart_ns)), None)
        if into is None:
            parted.append(group)
        else:
            into += group
    silent = [number for number, logs in enumerate(known) if not _begins(logs)]
    first, *others = parted or [[]]
    return [sorted(first + silent), *map(sorted, others)]


def began_ns(known: Sequence[Logs], group: Group) -> int:
    """When the first observation of a mission was made; of one in which there is any."""
    return _span_ns(known, group)[0]


def _begins(logs: Logs) -> dict[Key, Entry]:
    return {key: log[0] for key, log in logs.entries.items() if log}


def _shares(one: Logs, other: Logs) -> bool:
    begins = _begins(one)
    return any(begins.get(key) == entry for key, entry in _begins(other).items())


def _may_be_one(known: Sequence[Logs], one: Group, other: Group, most_apart_ns: int) -> bool:
    (began, ended), (others_began, others_ended) = _span_ns(known, one), _span_ns(known, other)
    if max(began, others_began) - min(ended, others_ended) > most_apart_ns:
        return False
    begins = [_begins(known[each]) for each in one]
    return not any(mine.keys() & _begins(known[each]).keys() for each in other for mine in begins)


def _span_ns(known: Sequence[Logs], group: Group) -> tuple[int, int]:
    entries = [log for number in group for log in known[number].entries.values() if log]
    ended_ns = max(max(log[-1].order_ns for log in entries), *(_closed_ns(known[number]) for number in group))
    return min(log[0].order_ns for log in entries), ended_ns


def _closed_ns(logs: Logs) -> int:
    return max(logs.closed.values()) * TICK_NS
