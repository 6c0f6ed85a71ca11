"""A Ctrl-C that Python would lose.

Python raises KeyboardInterrupt in whatever code runs just then. Where that is a finaliser or a callback of a library
in C (loading compiled code has thousands), the exception is printed as ignored and the program goes on: a mission that
somebody has just stopped would start. Such an interrupt is raised once more, a moment later.
"""

import _thread
import sys
import threading

AGAIN_S = 0.05


def keep_interrupts() -> None:
    """From now on no KeyboardInterrupt is ignored in this process; what else cannot be raised is printed as before."""
    sys.unraisablehook = _cannot_be_raised


def _cannot_be_raised(unraisable: "sys.UnraisableHookArgs") -> None:
    if not issubclass(unraisable.exc_type, KeyboardInterrupt):
        sys.__unraisablehook__(unraisable)
        return
    again = threading.Timer(AGAIN_S, _thread.interrupt_main)
    again.daemon = True
    again.start()
