"""What becomes of a page after Markdown: formulas, pictures, and what it would load."""

from __future__ import annotations

from pathlib import Path

import pytest

from anchorflow_docs.built_html import (
    dark_variant,
    external_loads,
    formulas_as_mathml,
    loads_of_html,
    loads_of_style,
    show_by_scheme,
)


def test_a_formula_becomes_mathml() -> None:
    block = formulas_as_mathml(r'<div class="arithmatex">\[x &lt; \bigl(y\bigr)\]</div>')
    inline = formulas_as_mathml(r'a <span class="arithmatex">\(x_0\)</span> b')

    assert block.startswith('<math xmlns="http://www.w3.org/1998/Math/MathML" display="block">')
    assert "&lt;" in block or "&#x0003C;" in block
    assert "bigl" not in block
    assert inline.startswith("a <math")
    assert 'display="inline"' in inline
    assert inline.endswith("</math> b")


def test_a_picture_with_a_dark_variant_is_shown_by_scheme(tmp_path: Path) -> None:
    for name in ("flow.png", "flow.dark.png", "loss.png"):
        (tmp_path / name).touch()
    html = '<p><img alt="The flow" src="../images/flow.png" /><img src="images/loss.png"></p>'

    shown = show_by_scheme(html, images=tmp_path)

    assert (
        '<img class="only-light" loading="lazy" alt="The flow" src="../images/flow.png" />' in shown
    )
    assert 'class="only-dark"' in shown
    assert 'src="../images/flow.dark.png"' in shown
    assert '<img src="images/loss.png">' in shown


def test_the_dark_variant_stands_beside_its_picture() -> None:
    assert dark_variant(Path("images/flow.png")) == Path("images/flow.dark.png")


@pytest.mark.parametrize(
    ("html", "loads"),
    [
        ('<a href="https://example.org/">a link</a>', []),
        ('<img src="images/flow.png"><script src="../a.js"></script>', []),
        ('<img src="https://example.org/a.png">', ["https://example.org/a.png"]),
        ('<script src="//example.org/a.js"></script>', ["//example.org/a.js"]),
        ('<link rel="stylesheet" href="https://example.org/a.css">', ["https://example.org/a.css"]),
        ("<style>@import 'https://example.org/a.css';</style>", ["https://example.org/a.css"]),
        ("<p>@import 'https://example.org/a.css'</p>", []),
        ('<p style="background: url(http://example.org/a)">', ["http://example.org/a"]),
        ('<pre class="mermaid"><code>graph</code></pre>', ["mermaid"]),
    ],
)
def test_what_a_page_would_load_from_elsewhere(html: str, loads: list[str]) -> None:
    assert loads_of_html(html) == loads


def test_what_a_style_sheet_would_load_from_elsewhere() -> None:
    style = 'a { background: url("data:image/svg+xml,%3Csvg") } @import url(//fonts.example/a);'

    assert loads_of_style(style) == ["//fonts.example/a"]


def test_loads_are_told_with_their_file(tmp_path: Path) -> None:
    (tmp_path / "page").mkdir()
    (tmp_path / "page" / "index.html").write_text('<img src="http://example.org/a.png">')
    (tmp_path / "good.css").write_text("a { color: red }")

    assert list(external_loads(tmp_path)) == ["page/index.html: http://example.org/a.png"]
