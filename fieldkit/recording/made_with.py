"""What a recording was made with: versions, and the very code that decides, which may change within one version."""

import platform
from functools import cache
from hashlib import sha256
from pathlib import Path

from fieldkit import __version__

ROOT = Path(__file__).parents[2]
DECIDING = (
    "fieldkit/channel", "fieldkit/engine", "fieldkit/geometry", "fieldkit/messages.py", "fieldkit/settings.py",
    "fieldkit/tuning.py", "mission/core", "mission/safety",
)  # fmt: skip
"""Where the code is that a replay runs again."""
NOT_NOTED = "not noted"


def software() -> dict[str, str]:
    """The versions that a mission's numbers may depend on; `code` also of states between two versions."""
    from importlib.metadata import version

    libraries = {name: version(name) for name in ("numpy", "scipy", "numba")}
    commit = commit_of(ROOT)
    return {
        "fieldkit": __version__,
        "code": code_of(ROOT),
        **({"commit": commit} if commit else {}),
        "python": platform.python_version(),
        "machine": platform.machine(),
        **libraries,
    }


def differences(made: dict[str, str]) -> str:
    """In what `made` differs from what runs here, and what can replay it; empty where nothing does."""
    here = software()
    made = {"code": NOT_NOTED} | made
    differing = [
        f"{name} {made[name]} (here {here.get(name, 'none')})"
        for name in made
        if made[name] != here.get(name)
    ]
    if not differing:
        return ""
    said = f"it was recorded with {', '.join(differing)}"
    if "fieldkit" not in made:
        return said
    which = f"fieldkit {made['fieldkit']}"
    if made["fieldkit"] == here["fieldkit"] and made["code"] != here["code"]:
        which += f", commit {made['commit'][:12]}," if "commit" in made else ", as it was then,"
    return f"{said}; {which} can replay it"


@cache
def code_of(root: Path) -> str:
    """A short hash of the code that decides, below the folder that holds the packages."""
    names = (sorted(path.rglob("*.py")) if (path := root / part).is_dir() else [path] for part in DECIDING)
    total = sha256()
    for path in (path for paths in names for path in paths):
        text = path.read_bytes().replace(b"\r\n", b"\n")
        total.update(f"{path.relative_to(root).as_posix()} {len(text)}\n".encode() + text)
    return total.hexdigest()[:12]


def commit_of(root: Path) -> str:
    """The commit that is checked out there; empty where no checkout is, or its git folder looks unfamiliar."""
    try:
        git = root / ".git"
        if git.is_file():  # a work tree beside the checkout
            git = root / git.read_text(encoding="utf-8").removeprefix("gitdir:").strip()
        head = (git / "HEAD").read_text(encoding="utf-8").strip()
        if not head.startswith("ref:"):
            return head
        name = head.removeprefix("ref:").strip()
        common = git / "commondir"
        home = git / common.read_text(encoding="utf-8").strip() if common.is_file() else git
        if (home / name).is_file():
            return (home / name).read_text(encoding="utf-8").strip()
        packed = (home / "packed-refs").read_text(encoding="utf-8")
        return next((line.split()[0] for line in packed.splitlines() if line.endswith(f" {name}")), "")
    except (OSError, ValueError):
        return ""
