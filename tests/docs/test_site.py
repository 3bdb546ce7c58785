"""The whole site builds without a warning, which every broken link would be."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from pictures import PICTURES

from anchorflow_docs.built_html import dark_variant

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PICTURE = re.compile(r"\]\(images/([^)]+)\.png\)")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """As `make docs` builds it."""
    folder = tmp_path_factory.mktemp("site")
    words = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    built = subprocess.run(
        words,
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert built.returncode == 0, built.stderr
    return folder


def test_the_reference_is_part_of_the_site(site: Path) -> None:
    page = (site / "reference" / "request.html").read_text()

    assert "<code>cost_map.resolution</code>" in page
    assert (site / "reference" / "openapi.json").is_file()


def test_no_formula_is_left_as_latex(site: Path) -> None:
    page = (site / "models.html").read_text()

    assert "<math" in page
    assert "arithmatex" not in page


def test_both_pictures_of_a_pair_are_on_the_page(site: Path) -> None:
    page = (site / "concepts.html").read_text()

    assert 'src="images/flow.png"' in page
    assert 'src="images/flow.dark.png"' in page


def test_no_source_is_published(site: Path) -> None:
    assert not list(site.rglob("*.py"))


@pytest.mark.parametrize("name", PICTURES)
def test_every_picture_is_drawn_for_both_schemes(name: str) -> None:
    picture = DOCS / "images" / f"{name}.png"

    assert picture.is_file()
    assert dark_variant(picture).is_file()


@pytest.mark.parametrize("name", ["index.md", "concepts.md"])
def test_every_picture_of_a_page_is_one_that_can_be_drawn_again(name: str) -> None:
    shown = PICTURE.findall((DOCS / name).read_text())

    assert shown
    assert set(shown) <= set(PICTURES)
