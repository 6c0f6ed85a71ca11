"""What ships is what is declared: NOTICE against the dependencies and their own word on licences."""

import re
import tomllib
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path

import pytest

import fieldkit

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
ROW = re.compile(r"^([a-z][a-z0-9-]+) {2,}(\S.*)$", re.MULTILINE)
NOTED = dict(ROW.findall((ROOT / "NOTICE").read_text(encoding="utf-8")))
FAMILIES = ("LGPL", "GPL", "MPL", "APACHE", "BSD", "MIT", "PSF")
"""The most demanding first: a licence counts as the first family it names."""


def name_of(requirement: str) -> str:
    found = re.match(r"[A-Za-z0-9-]+", requirement)
    assert found is not None
    return found[0].lower()


BASE = {name_of(each) for each in PROJECT["dependencies"]}
EXTRA = {
    name_of(each)
    for extra, wanted in PROJECT["optional-dependencies"].items()
    if extra != "dev"
    for each in wanted
}


def family(text: str) -> str:
    spelt = text.upper().replace("LESSER GENERAL PUBLIC", "LGPL").replace("MOZILLA PUBLIC", "MPL")
    spelt = spelt.replace("PYTHON SOFTWARE FOUNDATION", "PSF").replace("3-CLAUSE BSD", "BSD")
    return next((each for each in FAMILIES if each in spelt), spelt)


def test_the_notice_names_all_dependencies_and_nothing_else() -> None:
    assert set(NOTED) == BASE | EXTRA


@pytest.mark.parametrize("name", sorted(BASE | EXTRA))
def test_a_dependency_has_the_licence_that_the_notice_says(name: str) -> None:
    try:
        said = metadata(name)
    except PackageNotFoundError:
        pytest.skip(f"{name} is not installed: it belongs to an extra")
    classified = [
        each.removeprefix("License :: OSI Approved")
        for each in said.get_all("Classifier") or []
        if each.startswith("License :: OSI Approved ::")
    ]
    expression = (said.get("License-Expression") or "").partition(" AND ")[0]
    own = expression or " ".join(classified) or said.get("License") or ""
    assert family(own) == family(NOTED[name].partition(". ")[0].partition(", with")[0]), own


def test_version_changelog_and_citation_agree() -> None:
    assert PROJECT["version"] == fieldkit.__version__
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert f"## {fieldkit.__version__}" in changes
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"version: {fieldkit.__version__}\n" in citation and f"license: {PROJECT['license']}\n" in citation
