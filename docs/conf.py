"""Configuration of the documentation: `make docs`, and `make lessons` to execute the lessons."""

from importlib.metadata import version as version_of

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
exclude_patterns = ["_build", "conf.py"]
suppress_warnings = ["myst.header"]

default_role = "code"
autosummary_generate = True
autodoc_typehints = "signature"
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True, "show-inheritance": True}
napoleon_google_docstring = True
napoleon_numpy_docstring = False

html_theme = "furo"
html_title = f"sato {release}"


def prepare_docstring(app, what, name, obj, options, lines):
    """Make literal blocks of indented formulas, and escape bars, which are substitutions in RST."""
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
    source[0] = source[0].replace("](../", "](path:../")


def setup(app):
    """Prepare docstrings before napoleon reads them, and pages before they are parsed."""
    app.connect("autodoc-process-docstring", prepare_docstring, priority=400)
    app.connect("source-read", link_files)
