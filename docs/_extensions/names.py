"""Links from names to the reference, and the look of the gallery's figures."""

import re
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.ext import autosummary
from sphinx.transforms.post_transforms import SphinxPostTransform

# Of the examples; others come last.
ORDER = (
    "identify_from_loops",
    "straight_gain",
    "asymmetric_loops",
    "creep",
    "sensor_delay",
    "check_a_month_later",
    "compare_models",
    "measured_stage",
    "published_equation",
    "control_loop",
    "python_control",
    "saturating_limits",
    "scan_wave_table",
    "three_axis_scanner",
    "micrometres",
    "export_to_c",
)
NAME = re.compile(r"(dehyst(?:\.\w+)+)(?:\(.*\))?")


class LinkNames(SphinxPostTransform):
    """Link names such as `dehyst.Compensator`, in the code of a page's text, to the reference."""

    default_priority = 5

    def run(self, **kwargs: Any) -> None:
        """Wrap each literal that is a public name into a reference."""
        objects = self.env.domains["py"].objects
        for literal in list(self.document.findall(nodes.literal)):
            found = NAME.fullmatch(literal.astext())
            if not found or found[1] not in objects or not isinstance(literal.parent, nodes.Element):
                continue
            if isinstance(literal.parent, (nodes.reference, pending_xref)):
                continue
            link = pending_xref("", refdomain="py", reftype="obj", reftarget=found[1], refdoc=self.env.docname)
            literal.replace_self(link)
            link += literal


def missing(app: Sphinx, env: BuildEnvironment, node: pending_xref, content: nodes.Element) -> nodes.Node | None:
    """Find a class of a private module by its public name, and show other names in backticks as code.

    These are parameters, equations and files. All other references that lead nowhere stay warnings.
    """
    if node.get("refdomain") != "py":
        return None
    public = "dehyst." + node["reftarget"].rpartition(".")[2]
    if node["reftarget"].startswith("dehyst._") and public in env.domains["py"].objects:
        return env.domains["py"].resolve_xref(env, node["refdoc"], app.builder, "obj", public, node, content)
    return content if node["reftype"] == "obj" else None


class InOrderOfWork:
    """Sort key of the examples: as one works, from loops to firmware."""

    def __init__(self, folder: str) -> None:
        self._folder = folder

    def __repr__(self) -> str:
        return "<InOrderOfWork>"

    def __call__(self, name: str) -> tuple[int, str]:
        """Return the place of the example of this file name."""
        stem = Path(name).stem
        return ORDER.index(stem) if stem in ORDER else len(ORDER), name


def plain_figures(gallery: dict[str, Any], name: str) -> None:
    """Give each example's figures a white background, which dark pages need, and one size of letters."""
    import matplotlib as mpl

    mpl.rcParams.update(
        {
            "figure.figsize": (8, 4),
            "figure.facecolor": "white",
            "figure.constrained_layout.use": True,
            "savefig.facecolor": "white",
            "axes.spines.top": False,
            "axes.spines.right": False,
            "legend.frameon": False,
        }
    )


def setup(app: Sphinx) -> dict[str, bool]:
    """Register with Sphinx."""
    # Else a summary ends at the dot of the first.
    autosummary.WELL_KNOWN_ABBREVIATIONS += ("Eq.", "Eqs.", "Sec.")
    app.add_post_transform(LinkNames)
    app.connect("missing-reference", missing)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
