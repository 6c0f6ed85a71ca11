"""A whole, verified recording from one that was cut or damaged."""

from pathlib import Path

from fieldkit.recording.rewrite import rewrite


def recover(path_in: Path, path_out: Path) -> list[str]:
    """Write everything intact in `path_in` to `path_out` as a whole, verified file; returns what is missing.

    `path_out` must not exist; it appears only once it is complete and has been read back.
    """
    return rewrite(path_in, path_out, metadata=("recovered", {"from": path_in.name}))
