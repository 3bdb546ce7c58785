"""Hooks of MkDocs for the build of the site; `mkdocs.yml` names this file."""

from __future__ import annotations

import logging
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from anchorflow_docs.built_html import external_loads, formulas_as_mathml, show_by_scheme
from anchorflow_docs.reference import reference_pages

# Below MkDocs' own logger, where `--strict` counts warnings.
logger = logging.getLogger("mkdocs.hooks.anchorflow")


def on_files(files: Files, *, config: MkDocsConfig) -> Files:
    """Add the pages that are generated from the code."""
    for place, text in reference_pages().items():
        files.append(File.generated(config, place, content=text))
    return files


def on_page_content(html: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:  # noqa: ARG001 - MkDocs passes all by name
    """Convert formulas to MathML, and show pictures by colour scheme."""
    return show_by_scheme(formulas_as_mathml(html), images=Path(config.docs_dir) / "images")


def on_post_build(*, config: MkDocsConfig) -> None:
    """Warn of addresses outside the site that it would load."""
    for load in external_loads(Path(config.site_dir)):
        logger.warning("%s is loaded from outside the site", load)
