"""Sphinx configuration: Markdown pages, and a reference made of the docstrings of the public names."""

import inspect
from importlib.metadata import version as installed_version
from pathlib import Path

import ph_control

project = "ph_control"
author = "The ph_control developers"
release = version = installed_version("ph_control")

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "sphinx.ext.mathjax", "numpydoc"]
myst_enable_extensions = ["dollarmath"]
exclude_patterns = ["_build"]
html_theme = "alabaster"

autosummary_generate = True
numpydoc_show_class_members = False
templates_path = ["_templates"]
# references to names of other packages stay plain text
default_role = "literal"


def _write_reference(folder: Path) -> None:
    """Write one page that lists every public name, so that no list has to be kept by hand."""
    public = {name: getattr(ph_control, name) for name in ph_control.__all__}
    errors = {n for n, v in public.items() if inspect.isclass(v) and issubclass(v, BaseException)}
    classes = {n for n, v in public.items() if inspect.isclass(v)} - errors
    functions = {n for n, v in public.items() if inspect.isfunction(v)}
    lines = ["# Reference", "", "All names are those of the package: `import ph_control as phc`.", ""]
    for title, names in (("Classes", classes), ("Functions", functions), ("Errors and warnings", errors)):
        lines += [f"## {title}", "", "```{eval-rst}", ".. currentmodule:: ph_control", ""]
        lines += [".. autosummary::", "   :toctree: ."]
        lines += ["   :template: class.rst", ""] if title == "Classes" else [""]
        lines += [f"   {name}" for name in sorted(names)] + ["```", ""]
    folder.mkdir(exist_ok=True)
    (folder / "index.md").write_text("\n".join(lines), encoding="utf-8")


_write_reference(Path(__file__).parent / "api")
