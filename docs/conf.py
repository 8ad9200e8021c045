"""Sphinx configuration. `sphinx-build -W -b html docs docs/_build` writes the pages first."""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent)]  # this checkout's packages, and generate.py

project = "bnprl"
author = "The bnprl developers"
extensions = ["myst_parser"]
source_suffix = {".md": "markdown"}
exclude_patterns = ["_build"]
html_theme = "furo"
html_title = "bnprl"
smartquotes = False  # options begin with two hyphens
html_show_copyright = False
myst_heading_anchors = 2
suppress_warnings = ["config.cache"]


def setup(app):
    """Write the pages of the environments and experiments before Sphinx reads its sources."""
    import experiments
    import generate
    import learners

    def write(app):
        generate.write_pages(Path(app.srcdir) / "environments")
        experiments.write_pages(Path(app.srcdir) / "experiments")
        learners.write_page(Path(app.srcdir) / "experiments")

    app.connect("builder-inited", write)
