"""Sphinx configuration: Markdown pages, a reference made of the docstrings, and a gallery made of the examples."""

import inspect
import re
import shutil
from contextlib import suppress
from importlib.metadata import version as installed_version
from pathlib import Path

import latex2mathml.converter
from docutils import nodes
from sphinx import addnodes

import ph_control

HERE = Path(__file__).parent
LONG = 25  # characters of code that a narrow column of a table may break
# where long code breaks: not in Z(s), d_l, 1.5 or ||L||
BREAK = re.compile(
    r"((?<=[,/=:])(?=[^\s<&.:)\]])|(?<=\.)(?=[a-z])|(?<=[(\[])(?=[^\s()\[\]<&]{8})"
    r"|(?<=[a-z]{2}_)(?=[a-z]{2})|(?<=\w\|)(?=\w))(?![^<]*>)"
)
SHORT = 12  # characters of code that stay on one line
CODE = nodes.literal | nodes.math | nodes.FixedTextElement | nodes.raw
UNITS = "[kMG]?Hz|m?s|k?g|t|mm|k?N|MN/m|N/m|N s|ohm|[pnu]F|mH|dB|rad/s|degrees|GB|MB"

project = "ph_control"
author = "The ph_control developers"
release = version = installed_version("ph_control")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "sphinx_gallery.gen_gallery",
]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
exclude_patterns = ["_build"]

html_theme = "furo"
pygments_dark_style = "github-dark"  # that of furo underlines imports like links
html_title = f"ph_control {release}"
html_static_path = ["_static"]
html_css_files = ["custom.css"]
html_copy_source = html_show_sourcelink = html_show_copyright = False
html_math_renderer = "mathml"
smartquotes = False  # values such as 'zoh' are copied from the page

autosummary_generate = True
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False
templates_path = ["_templates"]
# the numpydoc section of a parameter tells its type better than an annotation
autodoc_typehints = "none"
# a name in single backticks is a literal, and `link_names` makes links of those that are public
default_role = "literal"

# The examples write their pictures into the folder they run in: for the gallery that is a copy.
COPY = HERE / "_build" / "examples"
shutil.rmtree(COPY, ignore_errors=True)
COPY.mkdir(parents=True)
for pattern in ("*.py", "*.rst"):
    for file in (HERE.parent / "examples").glob(pattern):
        shutil.copy(file, COPY)
sphinx_gallery_conf = {
    "examples_dirs": str(COPY),
    "gallery_dirs": "gallery",
    "filename_pattern": "",
    "within_subsection_order": "FileNameSortKey",
    "doc_module": ("ph_control",),
    "reference_url": {"ph_control": None},
    "backreferences_dir": "gallery/backreferences",
    "download_all_examples": False,
    "capture_repr": (),
    "show_signature": False,
    "write_computation_times": False,
    "parallel": 2,  # examples at a time
    "remove_config_comments": True,
    "thumbnail_size": (800, 560),
}


def public_pages():
    """Page and anchor of each public name, and of the members of each public class."""
    for name in ph_control.__all__:
        value = getattr(ph_control, name)
        page, anchor = f"api/ph_control.{name}", f"ph_control.{name}"
        yield name, (page, anchor)
        if inspect.isclass(value):
            for member in dir(value):
                yield f"{name}.{member}", (page, f"{anchor}.{member}")


def local_names(docname):
    """Names that mean a command, a member or a parameter on their page, rather than a function."""
    if docname == "command_line":
        return {"reduce", "netlist", "compare", "recording"}  # commands, and a key of an answer
    value = getattr(ph_control, docname.removeprefix("api/ph_control."), None) if docname.startswith("api/") else None
    names = {name for name in dir(value) if not name.startswith("_")} if inspect.isclass(value) else set()
    for one in (getattr(value, name) for name in names) if names else [value]:
        with suppress(TypeError, ValueError):  # of what has no signature
            names = names | set(inspect.signature(one).parameters)
    return names


def link_names(app, doctree, docname):
    """Make a link of each literal that is a public name, such as `pem` or `ph(Q, B)`, outside headings and links."""
    pages = dict(public_pages())
    own = local_names(docname)
    for literal in list(doctree.findall(nodes.literal)):
        if len(literal.astext()) > LONG:
            literal["classes"].append("long")
        elif len(literal.astext()) <= SHORT:
            literal["classes"].append("short")
        name = re.sub(r"\(.*\)$", "", literal.astext().removeprefix("phc."), flags=re.S)
        parent = literal.parent
        if name not in pages or name in own or isinstance(parent, nodes.reference | nodes.title | addnodes.desc_name):
            continue
        page, anchor = pages[name]
        if page == docname or page not in app.env.found_docs:
            continue
        member = "." in name and any(anchor in node["ids"] for node in app.env.get_doctree(page).findall(nodes.Element))
        target = app.builder.get_relative_uri(docname, page) + (f"#{anchor}" if member else "")
        link = nodes.reference("", "", refuri=target, internal=True)
        parent.replace(literal, link)
        link += literal


def link_types(app, doctree, docname):
    """Make a link of each public class in the type of a parameter, a result or an error."""
    names = "|".join(name for name in ph_control.__all__ if name[0].isupper())
    for text in list(doctree.findall(nodes.Text)) if docname.startswith("api/") else []:
        parts = re.split(rf"(?<![\w.])({names})(?!\w)", text)
        if len(parts) == 1 or not isinstance(text.parent, nodes.term | nodes.classifier):
            continue
        linked = [nodes.Text(part) for part in parts]
        for k in range(1, len(parts), 2):
            page = f"api/ph_control.{parts[k]}"
            if page != docname and page in app.env.found_docs:
                target = app.builder.get_relative_uri(docname, page)
                linked[k] = nodes.reference("", parts[k], refuri=target, internal=True)
        text.parent.replace(text, linked)


def trim_code(app, doctree):
    """Take the empty lines off the end of code, which a doctest needs before the closing fence."""
    for block in doctree.findall(nodes.literal_block):
        if len(block) == 1 and isinstance(block[0], nodes.Text):
            block.rawsource = block.astext().rstrip("\n")
            block[:] = [nodes.Text(block.rawsource)]


def hold_units(app, doctree):
    """Keep a per cent sign, a unit and the thousands of 20 000 on the line of their number, outside code."""
    for text in list(doctree.findall(nodes.Text)):
        held = re.sub(rf"(?<=\d) (?=(?:%|\d{{3}}|{UNITS})(?!\w))", "\u00a0", text)
        if held != text and not isinstance(text.parent, CODE):
            text.parent.replace(text, nodes.Text(held))


def break_long_code(app, pagename, templatename, context, doctree):
    """Let long code break after punctuation, but neither options nor numbers such as 1e-3."""
    if "body" in context:
        code = re.compile(r'(<code class="[^"]*\bliteral\b[^"]*">)(.*?)(</code>)', flags=re.S)
        body = code.sub(lambda found: found[1] + _breakable(found[1], found[2]) + found[3], context["body"])
        body = re.sub(r"(?<=[>\s(])(\d[\d.]*e-\d+)(?![^<]*>)", r'<span class="whole">\1</span>', body)
        if pagename.startswith("api/"):  # names that are wider than a phone
            body = re.sub(r"(?<=<h1>)\w+", lambda name: re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=_)", "<wbr>", name[0]), body)
            types = re.compile(r'(?<=<span class="classifier">)[^<]+')
            body = types.sub(lambda kind: re.sub(r"(?<=\w\.)(?=[A-Za-z])", "<wbr>", kind[0]), body)
        context["body"] = body


def _breakable(tag, text):
    """Text of code with places to break, and options and negative values held together."""
    if "long" in tag:
        text = BREAK.sub("<wbr>", text)
    return re.sub(r"(?<![\w-])(--?\w[a-z-]*)(?![^<]*>)", r'<span class="whole">\1</span>', text)


def without_private(_app, _what, _name, _obj, _options, signature, return_annotation):
    """Leave private parameters out of a signature."""
    return signature and re.sub(r", _\w+(=[^,)]*)?", "", signature), return_annotation


def visit_math(self, node):
    """Write a formula as MathML, which browsers draw without a script and without a network."""
    self.body.append(latex2mathml.converter.convert(node.astext()))
    raise nodes.SkipNode


def visit_displaymath(self, node):
    """Write a formula of its own line as MathML."""
    self.body.append(f'<div class="math">{latex2mathml.converter.convert(node.astext(), display="block")}</div>')
    raise nodes.SkipNode


def setup(app):
    """Add what the extensions above do not do."""
    app.add_html_math_renderer("mathml", (visit_math, None), (visit_displaymath, None))
    app.connect("doctree-read", trim_code)
    app.connect("doctree-read", hold_units)
    app.connect("doctree-resolved", link_names)
    app.connect("doctree-resolved", link_types)
    app.connect("html-page-context", break_long_code)
    app.connect("autodoc-process-signature", without_private)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
