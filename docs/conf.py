"""Configuration of the documentation: `make docs`, and `make lessons` to execute the lessons."""

import inspect
from dataclasses import MISSING
from importlib.metadata import version as version_of

from sphinx.ext import autosummary

from dynamics.units import Unit
from sato.scenario.definition import Definition, fields_of

project = "sato"
author = "The sato developers"
version = release = version_of("sato-swarm")

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
]
myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 3
nb_custom_formats = {".py": ["jupytext.reads", {"fmt": "py:percent"}]}
nb_execution_mode = "off"  # `make lessons` sets "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 120  # of a cell [s]
nb_merge_streams = True
nb_code_prompt_show, nb_code_prompt_hide = "Show the answer", "Hide the answer"
exclude_patterns = ["_build", "_static", "_templates", "conf.py"]
suppress_warnings = ["myst.header"]

default_role = "code"
highlight_language = "none"  # blocks that name no language are output
templates_path = ["_templates"]
autosummary_generate = True
autosummary.WELL_KNOWN_ABBREVIATIONS += ("eq.", "sec.", "Sec.")  # do not end a sentence
autodoc_typehints = "signature"
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True, "show-inheritance": True}
napoleon_google_docstring = True
napoleon_numpy_docstring = False

html_theme = "furo"
html_title = f"sato {release}"
html_static_path = ["_static"]
html_css_files = ["pages.css"]


def prepare_docstring(app, what, name, obj, options, lines):
    """Make literal blocks of indented formulas, and escape bars, which are substitutions in RST."""
    if inspect.isclass(obj) and issubclass(obj, Definition):
        add_fields(obj, lines)
    if what == "property":  # napoleon would take what stands before a colon for the type
        lines[:1] = [line.replace(": ", " – ") for line in lines[:1]]
    found, is_formula = [], False
    last = ""  # line that is not blank
    for number, line in enumerate(lines):
        is_indented = line.startswith("    ")
        follows_blank = number > 0 and not lines[number - 1].strip()
        if line.strip():
            if is_indented and not is_formula and follows_blank and last and last[0] != " ":
                found += ["::", ""]
                is_formula = True
            is_formula = is_formula and is_indented
            last = line
        found.append(line if is_formula else line.replace("|", "\\|"))
    lines[:] = found


def link_files(app, docname, source):
    """Let links to files outside of the pages lead to copies of these files."""
    up = "../" * (docname.count("/") + 1)  # out of the folder of pages
    source[0] = source[0].replace(f"]({up}", f"](path:{up}")


def add_fields(definition, lines):
    """List the fields that the docstring leaves out, with their units and meanings."""
    text = "\n".join(lines)
    missing = [field for field in fields_of(definition) if f"\n    {field.name}: " not in text]
    rows = [f"    {each.name}: {each.meaning}{unit_of(each)}." for each in missing]
    if "Args:" in lines:
        at = lines.index("Args:") + 1
        while at < len(lines) and (lines[at].startswith("    ") or not lines[at]):
            at += 1
        while not lines[at - 1]:
            at -= 1
        lines[at:at] = rows
    elif rows:
        lines += ["", "Args:", *rows, ""]


def unit_of(field):
    """Return the unit of a field in brackets; empty where it has none."""
    units = [mark for mark in field.marks if isinstance(mark, Unit)]
    return f" [{units[0]}]" if units else ""


def shorten_signature(app, what, name, obj, options, signature, returned):
    """Leave only names and plain defaults in the signature of a definition."""
    if not (inspect.isclass(obj) and issubclass(obj, Definition)):
        return None
    parts = []
    for each in fields_of(obj):
        is_plain = isinstance(each.default, bool | int | float | str | None)
        default = repr(each.default) if is_plain else "…"
        parts.append(each.name if each.default is MISSING else f"{each.name}={default}")
    return f"({', '.join(parts)})", None


def setup(app):
    """Prepare docstrings before napoleon reads them, signatures, and pages."""
    app.connect("autodoc-process-docstring", prepare_docstring, priority=400)
    app.connect("autodoc-process-signature", shorten_signature)
    app.connect("source-read", link_files)
