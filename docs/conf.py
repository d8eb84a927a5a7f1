"""Sphinx configuration (``make docs``).

The source folder is the root of the repository, so that the links between docs/, notebooks/ and the
rest are the same here as on a forge.
"""

project = "nonexp"
author = "The nonexp authors"
project_copyright = "The nonexp authors"

root_doc = "docs/index"
include_patterns = ["docs/**.md", "docs/index.rst", "notebooks/*.ipynb", "CHANGELOG.md"]
exclude_patterns = [".*", "out", "build", "shared", "docs/README.md"]

extensions = ["myst_nb"]
myst_enable_extensions = ["dollarmath", "amsmath"]
myst_heading_anchors = 3
suppress_warnings = ["toc.empty_glob"]

nb_execution_mode = "force"
nb_execution_timeout = 900
nb_execution_raise_on_error = True
nb_merge_streams = True

html_theme = "furo"
html_title = "nonexp"
html_theme_options = {"navigation_with_keys": True}
html_show_sphinx = False
