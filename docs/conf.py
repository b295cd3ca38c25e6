"""The site of the documentation, which `make docs` builds: the pages as they lie here,
with the scripts executed.
"""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from myst_parser.parsers.sphinx_ import MystParser

ROOT = Path(__file__).resolve().parent.parent

project = "gaitsweep"
root_doc = "README"
source_suffix = {".md": "markdown", ".rst": "restructuredtext", ".py": "percent"}
include_patterns = [
    "*.md",
    "docs/*.md",
    "docs/reference.rst",
    "docs/tutorial.py",
    "docs/gallery/*.py",
]
# Where no pages are looked for.
exclude_patterns = [
    ".*",
    "build",
    "data",
    "gaitsweep",
    "pipeline",
    "reports",
    "tasks",
    "tests",
]
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
myst_heading_anchors = 3
default_role = "code"  # as names are written in docstrings
autodoc_typehints = "none"  # docstrings have them
html_theme = "furo"
pygments_dark_style = "github-dark"
html_title = "gaitsweep"
html_static_path = ["site.css"]
html_css_files = ["site.css"]
html_copy_source = html_show_copyright = html_use_index = html_domain_indices = False

TREE = {
    "Use": [
        "tutorial",
        "python",
        "reference",
        "studies",
        "archive",
        "your-own-walker",
        "conventions",
        "cluster",
        "glossary",
    ],
    "Gallery": [
        f"gallery/{script.stem}" for script in sorted(ROOT.glob("docs/gallery/*.py"))
    ],
    "Why it can be trusted": ["capabilities", "trust", "physics", "proofs", "inside"],
    "Development": ["extending", "/CONTRIBUTING", "/CHANGELOG"],
}


def add_tree(app, name, source):
    """The pages of the site, which the README lists as other viewers show them."""
    if name == root_doc:
        for caption, pages in TREE.items():
            paths = "\n".join(
                page if page[0] == "/" else f"docs/{page}" for page in pages
            )
            source[0] += (
                f"\n```{{toctree}}\n:hidden:\n:caption: {caption}\n\n{paths}\n```\n"
            )


class Executed(MystParser):
    """A script in percent format, run in a folder and a process of its own."""

    supported = ("percent",)

    def parse(self, inputstring, document):
        command = [
            sys.executable,
            str(ROOT / "docs" / "percent.py"),
            document["source"],
        ]
        with tempfile.TemporaryDirectory() as folder:
            done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError(done.stderr)
        super().parse(done.stdout, document)


def copy_first_page(app, exception):
    if not exception:
        shutil.copy(app.outdir / "README.html", app.outdir / "index.html")


def setup(app):
    app.add_source_parser(Executed)
    app.connect("source-read", add_tree)
    app.connect("build-finished", copy_first_page)
