"""Shortcomings of docstrings of public names: parameters, units, shapes and errors left out."""

import ast
import inspect
import re
import textwrap
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import dynamics
import problems
import sato
from sato.scenario.definition import fields_of, is_definition

PAGE = Path(__file__).parents[1] / "docs/reference.md"
NUMERIC = re.compile(
    r"\bfloat\b|\b(Float|Complex|Numbers)\[|"
    r"\b(Times|States|Controls|StateSamples|ControlSamples|Vectors|ArrayLike)\b"
)
SHAPE = re.compile(
    r"\[Array, ['\"]|\b(Times|States|Controls|StateSamples|ControlSamples|Vectors)\b"
)
UNIT = re.compile(r"\[[^\]]*(?:\bm\b|\bs\b|\brad\b|/s|/kg)[^\]]*\]|\bSI units\b")
UNITLESS = re.compile(
    r"\b(relative|ratio|fraction|share|part|factor|number|unit|cosine|eccentricity|true|mask|"
    r"priority|normal|weights?|norm|coefficients|entries of|units of|scaled|dimensionless|"
    r"oblateness|over R|increment)\b",
    flags=re.IGNORECASE,
)


def public_names() -> list[Any]:
    """List all names of `sato`, and those of the packages below that the reference has."""
    found = [getattr(sato, name) for name in sato.__all__]
    text = PAGE.read_text("utf-8")
    for package in (dynamics, problems):
        blocks = re.findall(rf"currentmodule:: {package.__name__}\n(.*?)```", text, flags=re.S)
        names = [name for block in blocks for name in re.findall(r"^   (\w+)$", block, re.M)]
        found += [getattr(package, name) for name in names]
    return found


class Documented:
    """Function, method or property, by its source."""

    def __init__(self, function: Any, owner: type | None = None) -> None:
        self.name, self.owner = function.__name__, owner
        source = inspect.getsource(inspect.unwrap(function))
        tree = ast.parse(textwrap.dedent(source)).body[0]
        assert isinstance(tree, ast.FunctionDef)
        self.tree, self.own_text = tree, ast.get_docstring(tree) or ""

    @cached_property
    def text(self) -> str:
        """Docstrings of the function and of those that it overrides: documented once, there."""
        owners = inspect.getmro(self.owner)[1:] if self.owner else ()
        inherited = [getattr(vars(each).get(self.name), "__doc__", None) for each in owners]
        return "\n".join([self.own_text, *filter(None, map(cleaned, inherited))])

    @property
    def parameters(self) -> dict[str, str]:
        """Annotations by name, as they are written."""
        arguments = self.tree.args
        found = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]
        every = {each.arg: ast.unparse(each.annotation) for each in found if each.annotation}
        return every

    @property
    def returned(self) -> str:
        """Annotation of what is returned, as it is written."""
        return ast.unparse(self.tree.returns) if self.tree.returns else ""

    @property
    def raised(self) -> set[str]:
        """Names of the errors that the body raises itself."""
        nodes = [node.exc for node in ast.walk(self.tree) if isinstance(node, ast.Raise)]
        calls = [node.func for node in nodes if isinstance(node, ast.Call)]
        return {call.id for call in calls if isinstance(call, ast.Name)}


def cleaned(text: str | None) -> str:
    """Return a docstring without its indentation."""
    return inspect.cleandoc(text) if text else ""


def section(text: str, title: str) -> str:
    """Return the lines of all sections with a title."""
    return "\n".join(re.findall(rf"^{title}:\n((?:[ \t]+.*\n?|\n)+)", text, flags=re.M))


def described(text: str) -> dict[str, str]:
    """Return the description of each parameter, by name."""
    entries = re.findall(
        r"^ {4}(\w+(?:, \w+)*): (.*?)(?=^ {4}\w|\Z)", section(text, "Args"), re.M | re.S
    )
    return {name: about for names, about in entries for name in names.split(", ")}


def numeric_faults(where: str, name: str, kind: str, about: str | None) -> Iterator[str]:
    """Tell what the description of a number or an array lacks."""
    if not NUMERIC.search(kind):
        return
    if about is None:
        yield f"{where}: {name} is not described"
        return
    if not (UNIT.search(about) or UNITLESS.search(about)):
        yield f"{where}: no unit of {name}"
    is_array = "Array" in kind or SHAPE.search(kind)
    if is_array and not (SHAPE.search(kind) or re.search(r"\([\w ]+,", about)):
        yield f"{where}: no shape of {name}"


def function_faults(function: Any, owner: type | None = None) -> Iterator[str]:
    """Tell what the docstring of a function, a method or a property lacks."""
    one = Documented(function, owner)
    where = f"{owner.__name__}.{one.name}" if owner else one.name
    about = described(cleaned(owner.__doc__) if owner else "") | described(one.text)
    for name, kind in one.parameters.items():
        if owner is None and name not in about:
            yield f"{where}: {name} is not described"
        yield from numeric_faults(where, name, kind, about.get(name))
    if NUMERIC.search(one.returned):
        without = re.sub(r"^Args:\n(?:[ \t]+.*\n?|\n)+", "", one.text, flags=re.M)
        if not (UNIT.search(without) or UNITLESS.search(without)):
            yield f"{where}: no unit of what is returned"
    errors = section(one.text, "Raises")
    # A check of a definition raises `InputError`; a part of a mission is there once it is drawn.
    is_clear = one.text.startswith("Refuse") or re.search(r"\bonce\b.*\bdrawn\b", one.text)
    for error in one.raised - {"NotImplementedError", "AssertionError", "AttributeError"}:
        kind_of = getattr(sato, error, None) or getattr(problems, error, None)
        names = {error} | ({"ValueError"} if kind_of and issubclass(kind_of, ValueError) else set())
        if not is_clear and not any(name in errors for name in names):
            yield f"{where}: raises {error}"


def class_faults(found: type) -> Iterator[str]:
    """Tell what the docstrings of a class and its public members lack."""
    text = cleaned(found.__doc__)
    about = described(text)
    if is_definition(found) and not hasattr(found, "_fields"):
        for field in fields_of(found):
            is_number = NUMERIC.search(str(field.hint)) and not field.variants
            has_unit = field.key != field.name or UNITLESS.search(field.meaning)
            if not field.meaning or (is_number and not has_unit):
                yield f"{found.__name__}: no unit of {field.name}"
    elif is_dataclass(found):
        for each in fields(found):
            if not each.name.startswith("_") and each.init:
                kind = each.type if isinstance(each.type, str) else str(each.type)
                about_it = about.get(each.name)
                if about_it is None:
                    yield f"{found.__name__}: {each.name} is not described"
                else:
                    yield from numeric_faults(found.__name__, each.name, kind, about_it)
    for name, member in vars(found).items():
        # A class method, a property, a cached property or a function.
        parts = (getattr(member, part, None) for part in ("__func__", "fget", "func"))
        function = next(filter(None, parts), member)
        if not name.startswith("_") and inspect.isfunction(function):
            yield from function_faults(function, found)


def all_faults() -> list[str]:
    """List what the docstrings of all public names lack."""
    found: list[str] = []
    for each in public_names():
        found += class_faults(each) if isinstance(each, type) else function_faults(each)
    return found


if __name__ == "__main__":
    print(*all_faults(), sep="\n")
