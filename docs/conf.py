"""The site: `make docs` builds it into build/docs. It needs no network, and a warning is an error."""

import sys
from pathlib import Path

import dehyst

sys.path[:0] = [str(Path(__file__).parent / "_extensions"), str(Path(__file__).parents[1] / "tests" / "support")]

project = "dehyst"
author = project_copyright = "The dehyst developers"
version = release = dehyst.__version__
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "sphinx_click",
    "sphinx_gallery.gen_gallery",
    "names",
    "playground",
]
templates_path = ["_templates"]
exclude_patterns = ["_templates", "_extensions"]
nitpicky = True

myst_heading_anchors = 3
highlight_language = "none"

html_theme = "furo"
html_title = f"dehyst {version}"
html_static_path = ["_static"]
html_css_files = ["site.css", "playground.css"]
html_copy_source = False
html_show_sourcelink = False

# Names in single backticks of a docstring lead to the reference where it has them: see `_extensions/names.py`.
default_role = "py:obj"
autodoc_member_order = "groupwise"
toc_object_entries = False
autodoc_typehints = "none"
autodoc_preserve_defaults = True
autodoc_mock_imports = ["aioca"]
autosummary_generate = True
autosummary_ignore_module_all = False
autosummary_imported_members = True


def returned():
    """Face and name of each class that the public names give, which is described with its room."""
    import faces

    return [name.rsplit(".", 1) for name in faces.returned().values()]


# What `dehyst` offers is described there, and only linked from the pages of the rooms.
autosummary_context = {
    "top": sorted(set(dehyst.__all__) - {"__version__"}),
    "returned": returned(),
}
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False
numpydoc_attributes_as_param_list = True

sphinx_gallery_conf = {
    "examples_dirs": ["../examples/gallery"],
    "gallery_dirs": ["gallery"],
    "filename_pattern": r"\.py$",
    "within_subsection_order": "names.InOrderOfWork",
    "reset_modules": ("matplotlib", "names.plain_figures"),
    "download_all_examples": False,
    "show_memory": False,
    "show_signature": False,
    "min_reported_time": 1e9,
    "write_computation_times": False,
    "plot_gallery": "True",
    "abort_on_example_error": False,
    "only_warn_on_example_error": False,
}
