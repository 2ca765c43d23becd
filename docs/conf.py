"""How the pages become a site: ``sphinx-build -W docs build/docs``, offline."""

import sys
from pathlib import Path

import consistent_id

sys.path.insert(0, str(Path(__file__).parent / "_extensions"))

project = "consistent_id"
version = release = consistent_id.__version__
author = copyright = "consistent_id developers"

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "mathml",
    "public_names",
    "reference_keys",
    "shell_help",
]
exclude_patterns = ["_extensions", "paper"]

myst_enable_extensions = ["attrs_inline", "dollarmath"]
myst_heading_anchors = 3  # for links such as problem-file.md#drive-terms

default_role = "autolink"  # `name` links to what is documented, or stays as it is
autodoc_typehints = "none"  # the sections of the docstrings say types
autodoc_member_order = "bysource"
autosummary_generate = False
napoleon_google_docstring = False
napoleon_use_param = False  # types are prose: no words of theirs are links
napoleon_use_rtype = False
html_math_renderer = "mathml"

html_theme = "furo"
html_title = "consistent_id"
html_copy_source = False
html_extra_path = ["llms.txt"]  # where programmes look for it
html_static_path = ["_static"]
html_css_files = ["pages.css"]
