"""A page of ours as PDF, printed by the browser that shows it, or by WeasyPrint where that is installed instead."""

import shutil
import subprocess
import tempfile
from pathlib import Path

from fieldkit.errors import ConfigError, FieldkitError
from fieldkit.files import write_whole

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "msedge")
PATIENCE_S = 120.0


def write_pdf(page: Path, out: Path) -> None:
    """Print an HTML file to `out`, whole or not at all.

    Raises `ConfigError` where neither a Chromium nor WeasyPrint is there, `FieldkitError` where printing fails,
    `NotWritten`.
    """
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    printed = _by_weasyprint(page) if browser is None else _by_browser(browser, page, out)
    write_whole(out, printed)


def _by_browser(browser: str, page: Path, out: Path) -> bytes:
    with tempfile.TemporaryDirectory(prefix="fieldkit-") as made:
        target = Path(made) / "page.pdf"
        words = [
            browser, "--headless", "--no-sandbox", "--disable-gpu", "--no-pdf-header-footer",
            f"--user-data-dir={made}/profile", f"--print-to-pdf={target}", page.absolute().as_uri(),
        ]  # fmt: skip
        try:
            done = subprocess.run(words, capture_output=True, timeout=PATIENCE_S, check=False)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise FieldkitError(f"{out}: {browser} did not print it: {error}") from error
        if not target.exists():
            said = done.stderr.decode("utf-8", "replace").strip().splitlines()
            raise FieldkitError(f"{out}: {browser} did not print it: {said[-1] if said else 'no word why'}")
        return target.read_bytes()


def _by_weasyprint(page: Path) -> bytes:
    try:
        from weasyprint import HTML
    except (ImportError, OSError):
        raise ConfigError(
            "--pdf: needs Chromium or Chrome, or WeasyPrint (pip install weasyprint); "
            "any browser prints the HTML page too"
        ) from None
    return bytes(HTML(filename=str(page)).write_pdf())
