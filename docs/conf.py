"""How Sphinx builds the documentation site: `make docs`."""

from __future__ import annotations

import html
import io
import re
import sys
from pathlib import Path
from typing import Any

from docutils import nodes
from matplotlib.font_manager import FontProperties
from matplotlib.mathtext import math_to_image

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent)]

from study import __version__  # noqa: E402

project = "study"
author = "the study authors"
copyright = author  # noqa: A001
release = __version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "numpydoc"]
html_math_renderer = "drawn"
source_suffix = {".md": "markdown"}
exclude_patterns = ["_build", "_gallery"]
# Reports of shipped studies, gathered below: a folder `studies` of the site.
html_extra_path = ["_gallery/site"]
myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 3
html_theme = "furo"
html_title = "study"
numpydoc_show_class_members = False
autosummary_generate = False
autodoc_typehints = "none"
autodoc_member_order = "bysource"


def formula(tex: str) -> str:
    """Draw a formula as an inline SVG in the colour of the text, which needs no script or font."""
    drawn = io.BytesIO()
    one_line = " ".join(tex.split())
    depth = math_to_image(f"${one_line}$", drawn, prop=FontProperties(size=12), format="svg")
    svg = re.search(r"<svg.*</svg>", drawn.getvalue().decode(), re.DOTALL)
    assert svg is not None
    text = re.sub(r"<metadata>.*?</metadata>", "", svg[0], flags=re.DOTALL)
    text = re.sub(r' id="(?:figure|text|patch)_\d+"', "", text)
    name = f'<svg role="img" aria-label="{html.escape(one_line)}" fill="currentColor" '
    return text.replace("<svg ", name + f'style="vertical-align: -{depth:.1f}pt" ', 1)


def visit_math(translator: Any, node: nodes.math) -> None:
    """Write a formula of a line."""
    translator.body.append(formula(node.astext()))
    raise nodes.SkipNode


def visit_math_block(translator: Any, node: nodes.math_block) -> None:
    """Write a formula of its own, as wide as the page at most."""
    translator.body.append(f'<div style="overflow-x: auto">{formula(node.astext())}</div>')
    raise nodes.SkipNode


def setup(app: Any) -> None:
    """Write the pages that are made from the program before they are read."""
    import reference

    app.add_html_math_renderer("drawn", (visit_math, None), (visit_math_block, None))
    found = reference.gather(
        HERE.parent / "designs",
        (HERE / "_gallery" / "reports", HERE.parent / "reports"),
        HERE / "_gallery" / "site",
    )
    (HERE / "design-file.md").write_text(reference.design_file(), encoding="utf-8")
    (HERE / "python.md").write_text(reference.python(), encoding="utf-8")
    (HERE / "cookbook.md").write_text(reference.cookbook(HERE / "cookbook.ipynb"), encoding="utf-8")
    (HERE / "gallery.md").write_text(reference.gallery(HERE.parent / "designs", found), "utf-8")
