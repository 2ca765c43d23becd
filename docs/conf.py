"""How the pages become a site: ``sphinx-build -W docs build/docs``, offline.

Each released version has a folder of its own beside the others.  The variable
``CONSISTENT_ID_DOCS_VERSIONS`` names these folders, such as ``0.2.0 0.1.0``; every page
then has links to the other versions.
"""

import os
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
exclude_patterns = ["_extensions", "_templates", "paper"]

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
html_title = f"consistent_id {release}"
templates_path = ["_templates"]
html_sidebars = {
    "**": [
        "sidebar/brand.html",
        "sidebar/versions.html",
        "sidebar/search.html",
        "sidebar/scroll-start.html",
        "sidebar/navigation.html",
        "sidebar/scroll-end.html",
    ]
}
folders = os.environ.get("CONSISTENT_ID_DOCS_VERSIONS", "").split()
html_context = {"versions": [folder for folder in folders if folder != release]}
html_copy_source = False
html_extra_path = ["llms.txt"]  # where programmes look for it
html_static_path = ["_static"]
html_css_files = ["pages.css"]
