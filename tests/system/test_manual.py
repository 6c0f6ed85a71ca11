"""The manual: its tutorials are true, its reference is whole, and it asks nothing of the internet."""

import os
import re
import shutil
import subprocess
import sys
import threading
import urllib.request
from pathlib import Path

import matplotlib
import pytest

import fieldkit
from fieldkit import manual
from fieldkit.errors import ConfigError

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", re.MULTILINE | re.DOTALL)
FETCHED = re.compile(
    r"""(?:src|srcset)=["']?https?:|<link[^>]+href=["']?https?:(?![^>]*rel=["']?canonical)"""
)


@pytest.mark.parametrize("tutorial", sorted((DOCS / "tutorials").glob("*.md")), ids=lambda path: path.stem)
def test_a_tutorial_does_what_it_says(
    tutorial: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    matplotlib.use("Agg")
    shutil.copy(ROOT / "examples" / "readings.csv", tmp_path)
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    names: dict[str, object] = {"__name__": "tutorial"}
    blocks = BLOCK.findall(tutorial.read_text(encoding="utf-8"))
    assert {language for language, _ in blocks} <= {"sh", "python"} and len(blocks) >= 4
    for language, code in blocks:
        if language == "sh":
            done = subprocess.run(
                ["sh", "-e"], input=code, text=True, capture_output=True, check=False,
                env={**os.environ, "PATH": path},
            )  # fmt: skip
            assert done.returncode == 0, f"{code}\n{done.stdout}\n{done.stderr}"
        else:
            exec(compile(code, str(tutorial), "exec"), names)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)],
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        check=True,
    )
    return folder


def test_the_manual_fetches_nothing(site: Path) -> None:
    pages = list(site.rglob("*.html"))
    assert len(pages) > 25
    assert [page for page in pages if FETCHED.search(page.read_text(encoding="utf-8"))] == []
    sheets = "".join(sheet.read_text(encoding="utf-8") for sheet in site.rglob("*.css"))
    assert not re.search(r"@import|url\([\"']?https?:", sheets)


def test_the_reference_names_all_that_is_public(site: Path) -> None:
    text = (site / "reference" / "api.html").read_text(encoding="utf-8")
    text += (site / "reference" / "ports.html").read_text(encoding="utf-8")
    missing = [name for name in fieldkit.__all__ if name != "__version__" and name not in text]
    assert missing == []


def test_the_manual_is_served_on_this_computer(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(manual, "manual_folder", lambda: site)
    with manual.server() as serving:
        thread = threading.Thread(target=serving.serve_forever)
        thread.start()
        try:
            address = f"http://127.0.0.1:{serving.server_port}/explanations/silence.html"
            assert b"Why silence is evidence" in urllib.request.urlopen(address).read()
        finally:
            serving.shutdown()
            thread.join()


def test_an_installation_without_the_manual_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(manual.resources, "files", lambda package: tmp_path)
    with pytest.raises(ConfigError, match="carries no manual"):
        manual.manual_folder()
