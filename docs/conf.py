"""Sphinx's settings: `make docs` builds the site into build/docs, warnings are errors.

The source folder is the repository itself, so that links between the documents in its root, below docs/ and below
infra/ work both on a forge and on the site.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "extensions"))

import hfb

project = "hfb"
author = "the authors of hfb"
version = release = hfb.__version__
root_doc = "docs/index"
include_patterns = ["*.md", "docs/**.md", "infra/**.md", "findings/*.md", "tests/*.md", "examples/*.md"]
exclude_patterns = ["build/**", "runs/**", ".venv/**", ".*/**", "**/node_modules/**"]

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "generated_reference"]
myst_heading_anchors = 3
myst_enable_extensions = ["fieldlist"]
suppress_warnings = ["myst.header"]  # a document may begin below its title level, as an entry of CHANGELOG.md does
autodoc_class_signature = "separated"
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
napoleon_numpy_docstring = False

smartquotes = False

html_theme = "furo"
html_title = f"hfb {release}"
html_show_sphinx = False
html_copy_source = False
html_theme_options = {"navigation_with_keys": True}
