"""Sphinx's configuration of the site: Furo's pages, Markdown as GitHub reads it, nothing from the network."""

project = "RayBatch"
author = "The authors of RayBatch"
copyright = author
extensions = ["myst_parser"]
html_theme = "furo"
html_title = "RayBatch"
html_copy_source = False
html_show_sourcelink = False
html_show_sphinx = False
# headings are anchors, named as GitHub names them, and what a link names must be there
myst_heading_anchors = 6
myst_enable_extensions = ["strikethrough"]
suppress_warnings = ["myst.header", "misc.highlighting_failure"]
html_use_index = False
