"""When bytes became readable, even if nobody could look then.

A reader thread wakes up when its bytes arrive, but it can note the time only once it holds the interpreter's
lock, which a computing thread gives away every 5 ms at best; four robots that heard one packet at once would
be stamped one after another. Linux's `select` also says how much of its timeout was left when it woke up, and
so the moment itself.

A reader that did not run at all (the computer slept, the process was stopped) cannot know when what waits for it came:
`Attention` notices that.
"""

import ctypes
import select
import sys
import time
from collections.abc import Callable

from fieldkit.clock import awake_or_not_s

UNSEEN_S = 1.0
"""A reader looks ten times a second. One that has not for so long was not running."""
SETTLE_S = 0.3
"""What waited in a device, in the kernel or at the far end of a connection has been read so long after waking."""
_LIMIT = 1024
"""FD_SETSIZE: `select` knows no larger descriptors."""
_WORD_BITS = 8 * ctypes.sizeof(ctypes.c_ulong)


class _Timeval(ctypes.Structure):
    _fields_ = (("seconds", ctypes.c_long), ("microseconds", ctypes.c_long))


_FdSet = ctypes.c_ulong * (_LIMIT // _WORD_BITS)


def _libc_select() -> Callable[..., int] | None:
    if not sys.platform.startswith("linux"):
        return None
    try:
        found = ctypes.CDLL(None, use_errno=True).select
    except (OSError, AttributeError):
        return None
    found.restype = ctypes.c_int
    found.argtypes = [ctypes.c_int, *[ctypes.POINTER(_FdSet)] * 3, ctypes.POINTER(_Timeval)]
    return found


_SELECT = _libc_select()


def wait_readable(descriptor: int, timeout_s: float) -> float | None:
    """Wait for bytes; when they came, by `time.monotonic()`, or None if none came within `timeout_s`.

    Raises `OSError` for a descriptor that is closed.
    """
    if descriptor < 0:
        raise OSError("the device is closed")
    if _SELECT is None or descriptor >= _LIMIT:
        return time.monotonic() if select.select([descriptor], [], [], timeout_s)[0] else None
    watched = _FdSet()
    watched[descriptor // _WORD_BITS] = 1 << descriptor % _WORD_BITS
    whole = int(timeout_s)
    left = _Timeval(whole, round((timeout_s - whole) * 1e6))
    began_s = time.monotonic()
    ready = _SELECT(descriptor + 1, ctypes.byref(watched), None, None, ctypes.byref(left))
    if ready < 0:
        number = ctypes.get_errno()
        if number == 4:  # EINTR: a signal, not a fault
            return None
        raise OSError(number, "waiting for bytes failed")
    return began_s + timeout_s - left.seconds - left.microseconds * 1e-6 if ready else None


class Attention:
    """Whether a reader has been looking all along, and whether what it reads now may have waited for it."""

    def __init__(self, seconds: Callable[[], float] = awake_or_not_s) -> None:
        """`seconds`: a clock that goes on while the computer sleeps."""
        self._seconds = seconds
        self._looked_s = seconds()
        self._settled_s = self._looked_s

    def look(self) -> float:
        """To be called before and after each read; for how many seconds nobody had looked, 0 where somebody had."""
        now_s = self._seconds()
        away_s, self._looked_s = now_s - self._looked_s, now_s
        if away_s <= UNSEEN_S:
            return 0.0
        self._settled_s = now_s + SETTLE_S
        return away_s

    @property
    def settled(self) -> bool:
        """What is read now came while somebody looked."""
        return self._looked_s >= self._settled_s
