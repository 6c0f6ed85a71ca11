"""Whether a regular expression may think for ever: while it does, the whole mission stands still."""

import re
from collections.abc import Sequence
from re import _parser  # type: ignore[attr-defined] # the parse tree has no public name
from typing import Any

REPEATS = ("MAX_REPEAT", "MIN_REPEAT")
MANY = 100
"""A repeat of so many counts as one without end."""


def endless(pattern: str) -> bool:
    """Whether a repeat repeats nothing but a repeat, as in `(\\w+\\s?)*`: the time doubles with each letter of a line.

    Raises `re.error`. There are slow expressions of other kinds, which are not recognised.
    """
    re.compile(pattern)
    return _endless(list(_parser.parse(pattern)))


def _endless(items: Sequence[Any]) -> bool:
    return any(_is_endless(str(kind), given) for kind, given in items)


def _is_endless(name: str, given: Any) -> bool:
    if name in REPEATS:
        body = _open(given[2])
        return (given[1] >= MANY and _only_repeats(body)) or _endless(body)
    if name == "SUBPATTERN":
        return _endless(list(given[-1]))
    return name == "BRANCH" and any(_endless(list(each)) for each in given[1])


def _open(items: Any) -> list[Any]:
    """What is in a group that is all there is."""
    inner = list(items)
    while len(inner) == 1 and str(inner[0][0]) == "SUBPATTERN":
        inner = list(inner[0][1][-1])
    return inner


def _only_repeats(body: Sequence[Any]) -> bool:
    """Whether a repeat without end is all that must be there."""
    needed = [each for each in body if not (str(each[0]) in REPEATS and each[1][0] == 0)]
    if not needed:
        return any(each[1][1] >= MANY for each in body)
    return len(needed) == 1 and str(needed[0][0]) in REPEATS and needed[0][1][1] >= MANY
