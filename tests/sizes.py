"""How much a test tries: little where everything is tested at once, much with FIELDKIT_LONG=1."""

import os
from typing import TypeVar

T = TypeVar("T")


def size(short: T, long: T) -> T:
    """`short`, or `long` with FIELDKIT_LONG=1."""
    return long if os.environ.get("FIELDKIT_LONG") else short
