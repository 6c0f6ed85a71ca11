"""`njit` for the engine's loops: compiled code is kept for the next start where something can be written, else not.

numba keeps compiled code beside the source or in the user's cache folder, and refuses to compile where it can write
neither: a wheel that was installed read-only, a service without a home. Then a folder of our own under the system's
temporary folder takes its place, and where that cannot be written either each process compiles for itself.

numba compiles a function anew when its own file has changed, and not when that of a function has which it calls and
which is part of its compiled code. Ours are compiled anew then too.
"""

import logging
import os
import stat
import tempfile
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numba

logger = logging.getLogger(__name__)

Loop = TypeVar("Loop", bound=Callable[..., Any])


def njit(**options: Any) -> Callable[[Loop], Loop]:
    """`numba.njit` with these options; `cache=True` is a wish that cannot fail."""

    def compiled(function: Loop) -> Loop:
        try:
            return _njit(function, options)
        except RuntimeError as error:
            if not options.get("cache") or "cannot cache" not in str(error):
                raise
        if (folder := _fallback()) is not None:
            config: Any = numba.config  # its attributes are made at run time
            config.CACHE_DIR = str(folder)
            try:
                return _njit(function, options)
            except RuntimeError:
                logger.warning("compiled code cannot be kept in %s: each start compiles anew", folder)
        return _njit(function, {**options, "cache": False})

    return compiled


def _njit(function: Loop, options: dict[str, Any]) -> Loop:
    made: Loop = numba.njit(**options)(function)
    # No public name; without it numba looks at the function's own file alone.
    index: Any = getattr(getattr(made, "_cache", None), "_cache_file", None)
    if (files := sorted(set(_files_called(function)))) and hasattr(index, "_source_stamp"):
        index._source_stamp = (index._source_stamp, tuple(_stamp(file) for file in files))
    return made


def _files_called(function: Callable[..., Any]) -> Iterator[str]:
    """Where the compiled functions are written that it calls, and those that they call."""
    for name in function.__code__.co_names:
        if (called := getattr(function.__globals__.get(name), "py_func", None)) is not None:
            yield called.__code__.co_filename
            if called is not function:
                yield from _files_called(called)


def _stamp(file: str) -> tuple[str, float, int]:
    try:
        found = Path(file).stat()
    except OSError:  # inside an archive
        return file, 0.0, 0
    return file, found.st_mtime, found.st_size


@cache
def _fallback() -> Path | None:
    """A folder of this user alone: what is in it is run, so nobody else may have put it there. None: not to be had."""
    user = os.getuid() if hasattr(os, "getuid") else 0
    try:
        folder = Path(tempfile.gettempdir()) / f"fieldkit-compiled-{user}"
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return None
    foreign = hasattr(os, "getuid") and (found.st_uid != user or found.st_mode & 0o022)
    if not stat.S_ISDIR(found.st_mode) or foreign:
        logger.warning("%s belongs to somebody else: compiled code is not kept", folder)
        return None
    return folder
