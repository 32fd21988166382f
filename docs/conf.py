"""How Sphinx builds the documentation site: `make docs`."""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent)]

from study import __version__  # noqa: E402

project = "study"
author = "the study authors"
copyright = author  # noqa: A001
release = __version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.mathjax", "numpydoc"]
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


def setup(app: object) -> None:
    """Write the pages that are made from the program before they are read."""
    import reference

    found = reference.gather(
        HERE.parent / "designs",
        (HERE / "_gallery" / "reports", HERE.parent / "reports"),
        HERE / "_gallery" / "site",
    )
    (HERE / "design-file.md").write_text(reference.design_file(), encoding="utf-8")
    (HERE / "python.md").write_text(reference.python(), encoding="utf-8")
    (HERE / "cookbook.md").write_text(reference.cookbook(HERE / "cookbook.ipynb"), encoding="utf-8")
    (HERE / "gallery.md").write_text(reference.gallery(HERE.parent / "designs", found), "utf-8")
