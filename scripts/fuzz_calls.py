"""Call public functions with wrong arguments: python scripts/fuzz_calls.py --count 10000.

Each call begins with a valid one (`call_examples.py`, `call_examples_sato.py`) and changes one or
two arguments: type, shape, NaN, infinities, complex, booleans, 10**400, odd objects. It is right
if it is refused with an error of the library that names the argument, or returns what the valid
call with an equal argument returns. Exit code 1, and the calls by function, where

    raw      an error of Python, NumPy or a solver came out
    unnamed  the message names no argument that was changed
    taken    a value of a wrong kind was taken
    late     an object was made, and its methods then fail
    garbage  the result has NaN, which that of the valid call has not
    slow     no answer in 20 s
"""

import argparse
import contextlib
import dataclasses
import functools
import inspect
import io
import linecache
import os
import re
import resource
import signal
import sys
import tempfile
import traceback
import warnings
from collections import defaultdict
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple, get_args

import call_examples
import call_examples_sato
import numpy as np
from numpy import ndarray as Array
from numpy.random import Generator

from sato.scenario.definition import Definition, fields_of

ROOT = Path(__file__).parents[1]
PACKAGES = ("dynamics", "problems", "sato")
LIMIT_S = 20
MEMORY = 8 * 2**30  # that a call may address [byte]
HUGE = 10**400
# Names no argument, which its caller does; has no missions of its own; are made by runs alone.
NO_DOORS = {"as_array", "Mission.draw", "RunRecord"}


class SubclassOfFloat(float):
    """Number of the user's own."""


class Odd:
    """Object whose methods raise."""

    def __len__(self) -> int:
        raise KeyError("odd")

    def __float__(self) -> float:
        raise KeyError("odd")


def odd_values() -> list[tuple[str, Any]]:
    """List values that are numbers, arrays or text of no kind that is asked for."""
    return [
        ("None", None),
        ("object()", object()),
        ("odd object", Odd()),
        ("lambda", lambda *args: None),
        ("class", dict),
        ("generator", (i for i in range(3))),
        ("dict", {}),
        ("dict", {"a": 1}),
        ("bytes", b"1"),
        ("text", "1"),
        ("text", "nan"),
        ("long text", "x" * 100_000),
        ("complex", 1 + 0j),
        ("complex", np.complex128(2j)),
        ("bool", True),
        ("bool", np.False_),
        ("nan", float("nan")),
        ("nan", np.float32("nan")),
        ("inf", float("inf")),
        ("inf", -np.inf),
        ("10**400", HUGE),
        ("10**400", -HUGE),
        ("array of objects", np.array([object(), None])),
        ("array of text", np.array(["a", "b"])),
        ("list of text", ["1", "2"]),
        ("list of None", [None]),
        ("ragged list", [[1.0], [1.0, 2.0]]),
        ("masked array", np.ma.masked_array(np.ones(3), [0, 1, 0])),
        ("dates", np.array(["2020-01-01"], "datetime64[s]")),
        ("set", {1.0, 2.0}),
        ("list of 10**400", [HUGE, HUGE]),
    ]


WRONG_KINDS = {name for name, _ in odd_values()} | {"complex entries", "nan entry", "inf entry"}
WRONG_KINDS |= {"bool entries", "object entries", "text entries", "masked"}


class Change(NamedTuple):
    """Change of an argument: its name, the new value, and True where it means the same."""

    name: str
    value: Any
    is_equal: bool = False


def draw_change(value: Any, rng: Generator) -> Change:
    """Draw a change of a valid value."""
    changes: list[Change] = [Change(*pair) for pair in odd_values()]
    if isinstance(value, Array) and value.dtype.kind in "fiub" and value.size:
        changes = changes[:: max(1, rng.integers(1, 4))] + list(_array_changes(value, rng))
    elif isinstance(value, float | int) and not isinstance(value, bool):
        changes += list(_number_changes(value))
    elif isinstance(value, tuple | list) and value:
        changes += [
            Change("shorter", value[:-1]),
            Change("longer", [*value, value[-1]]),
            Change("empty", ()),
            Change("odd entry", [*value[:-1], draw_change(value[-1], rng).value]),
            Change("as a list", list(value), True),
        ]
    elif isinstance(value, str):
        changes += [Change("empty", ""), Change("other text", value[::-1] + "?")]
        changes += [Change("odd text", "\x00"), Change("with spaces", f" {value} ")]
    return changes[rng.integers(len(changes))]


def _number_changes(value: Any) -> Iterator[Change]:
    is_whole = isinstance(value, int)
    yield Change("as a number of NumPy", np.int64(value) if is_whole else np.float64(value), True)
    yield Change("as a subclass", SubclassOfFloat(value), not is_whole)
    yield Change("as an array", np.array(value), True)
    for other in (0, -1, -value, 1e300, 1e-300, 10**12, 2.5, -0.0, 1e9):
        yield Change(f"{other!r}", other)
    yield Change("as text", str(value))
    yield Change("in a list", [value])
    yield Change("as a float", float(value), not is_whole)


def _array_changes(value: Array, rng: Generator) -> Iterator[Change]:
    yield Change("as a list", value.tolist(), True)
    yield Change("in another order", np.asfortranarray(value), True)
    yield Change("read-only", _read_only(value), True)
    if not value.ndim:
        return
    yield Change("strided", np.repeat(value, 2, axis=0)[::2], True)
    for name, shape in (
        ("flat", (value.size,)),
        ("another axis", (1, *value.shape)),
        ("a last axis", (*value.shape, 1)),
    ):
        yield Change(name, value.reshape(shape))
    yield Change("transposed", value.T.copy())
    yield Change("a row less", value[:-1])
    yield Change("a row more", np.concatenate([value, value[:1]]))
    yield Change("a column less", value[..., :-1])
    yield Change("a column more", np.concatenate([value, value[..., :1]], axis=-1))
    yield Change("empty", np.zeros(0))
    yield Change("empty rows", value[:0])
    yield Change("one number", value.flat[0].item())
    yield Change("masked", np.ma.masked_array(value))
    yield Change("negative", -value.astype(float))
    yield Change("zero", 0 * value)
    yield Change("large", np.full(value.shape, 1e300))
    yield Change("of text", value.astype(str))
    yield Change("text entries", value.astype(str).tolist())
    if value.dtype.kind != "b":
        yield Change("bool entries", value > 0)
    yield Change("complex entries", value.astype(complex))
    yield Change("object entries", value.astype(object))
    for name, entry in (("nan entry", np.nan), ("inf entry", np.inf)):
        other = value.astype(float)
        other.flat[rng.integers(value.size)] = entry
        yield Change(name, other)
    if value.dtype.kind == "f":
        yield Change("as big-endian", value.astype(">f8"), True)


def _read_only(value: Array) -> Array:
    copy = value.copy()
    copy.flags.writeable = False
    return copy


class Example(NamedTuple):
    """Valid call of a public function."""

    function: Callable[..., Any]
    arguments: dict[str, Any]

    @property
    def name(self) -> str:
        """Name of the class or function, with that of its class."""
        if isinstance(self.function, functools.partial):
            return str(self.function.args[1])
        return str(self.function.__qualname__)

    def call(self, changes: dict[str, Any] | None = None) -> Any:
        """Call it, with some arguments changed."""
        return self.function(**(self.arguments | (changes or {})))


def load_examples() -> dict[str, Example]:
    """Load the valid calls, by name."""
    pairs = [*call_examples.list_calls(), *call_examples_sato.list_calls()]
    examples = [Example(*pair) for pair in pairs]
    return {example.name: example for example in examples}


def public_names() -> set[str]:
    """Find all public functions, constructors and methods that take arguments."""
    found: set[str] = set()
    for owner in _public_objects():
        if inspect.isclass(owner):
            if not (issubclass(owner, BaseException) or getattr(owner, "_is_protocol", False)):
                found |= _names_of_class(owner)
        elif inspect.isfunction(owner) and _is_ours(owner) and inspect.signature(owner).parameters:
            found.add(owner.__qualname__)
    return found - NO_DOORS


def _public_objects() -> Iterator[Any]:
    for package in map(import_module, PACKAGES):
        for name in dir(package):
            if not name.startswith("__"):
                yield getattr(package, name)
    pattern = r"^from ((?:dynamics|problems|sato)\S*) import (\([^)]*\)|[^\n(]*)"
    pages = [*sorted(ROOT.glob("docs/*.md")), *sorted(ROOT.glob("docs/lessons/*.*"))]
    for page in [ROOT / "README.md", *(page for page in pages if page.suffix in (".md", ".py"))]:
        for module, names in re.findall(pattern, page.read_text(encoding="utf-8"), re.MULTILINE):
            for name in re.findall(r"\w+", names):
                yield getattr(import_module(module), name, None)


def _is_ours(owner: Any) -> bool:
    return str(getattr(owner, "__module__", "")).partition(".")[0] in PACKAGES


def _names_of_class(owner: type) -> set[str]:
    found = set()
    if inspect.isabstract(owner) or not _is_ours(owner):
        return found
    if any(name in vars(owner) for name in ("__dataclass_fields__", "_fields", "__init__")):
        found.add(owner.__qualname__)
    for name in dir(owner):
        member = inspect.getattr_static(owner, name)
        function = getattr(member, "__func__", member)
        if name.startswith("_") or not (inspect.isfunction(function) and _is_ours(function)):
            continue
        if len(inspect.signature(function).parameters) > (not isinstance(member, staticmethod)):
            found.add(function.__qualname__)
    return found


def methods_of(found: Any, examples: dict[str, Example]) -> Iterator[Example]:
    """List the examples of methods, with an object of the same class in place of theirs."""
    for example in examples.values():
        owner = getattr(example.function, "__self__", None)
        if _is_ours(type(owner)) and type(owner) is type(found):
            yield Example(getattr(found, example.function.__name__), example.arguments)


def _properties_of(found: Any, valid: Any) -> list[Example]:
    kind = type(found)
    if not _is_ours(kind) or type(valid) is not kind:
        return []
    members = ((name, getattr(kind, name)) for name in dir(kind) if not name.startswith("_"))
    properties = [name for name, member in members if _is_property(member)]
    return [Example(functools.partial(getattr, found, name), {}) for name in properties]


def _is_property(member: Any) -> bool:
    return isinstance(member, property | functools.cached_property)


def _expected(method: Example, valid: Any, examples: dict[str, Example]) -> Any:
    if isinstance(method.function, functools.partial):
        return getattr(valid, method.function.args[1])
    return examples[method.name].call()


def has_nan(found: Any, depth: int = 0) -> bool:
    """Tell whether there is NaN in a result."""
    if isinstance(found, float | complex | np.generic | Array):
        array = np.asarray(found)
        return array.dtype.kind in "fc" and bool(np.isnan(array).any())
    return depth < 4 and any(has_nan(part, depth + 1) for part in _parts(found))


def _parts(found: Any) -> list[Any]:
    if isinstance(found, tuple | list):
        return list(found)
    if isinstance(found, dict):
        return list(found.values())
    if dataclasses.is_dataclass(found) and not isinstance(found, type):
        return [getattr(found, field.name, None) for field in dataclasses.fields(found)]
    return []


def are_equal(one: Any, other: Any, depth: int = 0) -> bool:
    """Compare two results, of which NumPy may sum arrays in another order."""
    if isinstance(one, float | int | np.generic | Array):
        try:
            return np.allclose(one, other, rtol=1e-6, atol=1e-9, equal_nan=True)
        except (TypeError, ValueError, OverflowError):
            return False
    parts, others = _parts(one), _parts(other)
    pairs = zip(parts, others, strict=False)
    same = len(parts) == len(others)
    return same and (depth > 4 or all(are_equal(*pair, depth + 1) for pair in pairs))


def judge(
    example: Example, changes: dict[str, Change], examples: dict[str, Example], strict: bool = True
) -> tuple[str, str]:
    """Return the verdict on a call, empty where it is right, and what came out."""
    values = {name: change.value for name, change in changes.items()}
    try:
        with _time_limit():
            found = example.call(values)
    except TimeoutError:
        return "slow", f"no answer in {LIMIT_S} s"
    except BaseException as error:
        if any(_is_callback(example.arguments[n], change) for n, change in changes.items()):
            return "", ""  # the function is the caller's own
        keys = [key for name in example.arguments for key in _keys(example, name)]
        is_wrong = any(change.name in WRONG_KINDS for change in changes.values())
        return _judge_error(error, keys if is_wrong else [])
    valid = example.call()
    is_equal = are_equal(found, valid)
    for name, change in changes.items():
        if is_equal and change.name in ("object entries", "complex entries"):
            continue  # of the same value, beside symbols or where complex numbers are taken
        if strict and _must_be_refused(example, name, change):
            return "taken", f"{name} was taken"
    if all(change.is_equal for change in changes.values()) and not is_equal:
        if not are_equal(example.call(), valid):
            return "", ""  # a clock or a generator is in the result
        return "garbage", "another result than for an equal argument"
    if strict and any(c.name in _allowed(example, n) for n, c in changes.items()):
        return "", ""  # NaN is for what is absent
    if has_nan(found) and not has_nan(valid):
        return "garbage", "NaN in the result"
    for method in [*_properties_of(found, valid), *methods_of(found, examples)]:
        try:
            with _time_limit():
                result = method.call()
        except TimeoutError:
            return "slow", f"{method.name}: no answer in {LIMIT_S} s"
        except BaseException as error:
            verdict, text = _judge_error(error, [])
            if verdict == "raw" and not any(
                _is_callback(example.arguments[n], change) for n, change in changes.items()
            ):
                return "late", f"{method.name}: {text}"
            continue
        if has_nan(result) and not has_nan(_expected(method, valid, examples)):
            return "late", f"{method.name}: NaN in the result"
    return "", ""


def _is_callback(valid: Any, change: Change) -> bool:
    return callable(valid) and callable(change.value)


def _keys(example: Example, name: str) -> list[str]:
    """List the names of an argument: its own, and the key of a file that it is the value of."""
    function: Any = example.function
    is_definition = inspect.isclass(function) and issubclass(function, Definition)
    keys = [f.key for f in fields_of(function) if f.name == name] if is_definition else []
    return [name, *keys, *(["system"] if name in ("scenario", "data") else [])]


def _must_be_refused(example: Example, name: str, change: Change) -> bool:
    valid, parameter = example.arguments[name], _parameter(example, name)
    if change.name in _allowed(example, name):
        return False
    if isinstance(valid, bool) or valid is None or callable(valid):
        return False
    if change.name not in WRONG_KINDS or change.is_equal:
        return False
    if change.value is None and (parameter is None or parameter.default is None):
        return False
    if change.name == "inf" and "inf" in get_args(parameter and parameter.annotation):
        return False  # the norm, as NumPy has it
    is_infinite = isinstance(parameter and parameter.default, float) and np.isinf(parameter.default)
    if change.name in ("inf", "inf entry") and is_infinite:
        return False
    if isinstance(valid, str) and "text" in change.name:
        return False
    if isinstance(valid, Array) and valid.dtype.kind in "bc":
        return change.name not in ("bool entries", "complex entries", "complex", "bool")
    return isinstance(valid, float | int | Array | str)


def _allowed(example: Example, name: str) -> tuple[str, ...]:
    allowed = call_examples.ALLOWED | call_examples_sato.ALLOWED
    return allowed.get(f"{example.name}.{name}", ())


def _parameter(example: Example, name: str) -> inspect.Parameter | None:
    return inspect.signature(example.function).parameters.get(name)


def _judge_error(error: BaseException, names: list[str]) -> tuple[str, str]:
    text = f"{type(error).__name__}: {str(error)[:200]}"
    if not _is_refusal(error):
        return "raw", text
    if str(error).startswith("t: ") and {"times", "dt", "t0"} & set(names):
        return "", text  # the time that follows from them
    is_named = not names or any(re.search(rf"\b{name}", str(error)) for name in names)
    is_named = is_named or bool(getattr(error, "key", "")) or "--set" in str(error)
    return ("", text) if is_named or type(error).__name__ != "InputError" else ("unnamed", text)


def _is_refusal(error: BaseException) -> bool:
    # An error of the library, or one that a line of it raises.
    if type(error).__module__.partition(".")[0] in PACKAGES:
        return True
    frames = list(traceback.walk_tb(error.__traceback__))
    code, line = frames[-1][0].f_code, frames[-1][1]
    if not isinstance(error, ValueError | RuntimeError | OSError):
        return False
    is_inside = any(f"/{package}/" in code.co_filename for package in PACKAGES)
    is_raised = "raise" in linecache.getline(code.co_filename, line)
    return isinstance(error, OSError) or (is_inside and is_raised)


@contextlib.contextmanager
def _time_limit() -> Iterator[None]:
    def stop(*args: Any) -> None:
        raise TimeoutError

    signal.signal(signal.SIGALRM, stop)
    signal.alarm(LIMIT_S)
    try:
        with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
            warnings.simplefilter("ignore")
            yield
    finally:
        signal.alarm(0)


def draw_changes(example: Example, rng: Generator) -> dict[str, Change]:
    """Draw changes of one or two arguments."""
    names = list(example.arguments)
    count = min(len(names), int(rng.integers(1, 3)) if rng.random() < 0.3 else 1)
    chosen = rng.choice(len(names), size=count, replace=False)
    return {names[k]: draw_change(example.arguments[names[k]], rng) for k in chosen}


def fuzz(
    count: int, seed: int, only: str = ""
) -> Iterator[tuple[Example, dict[str, Change], str, str]]:
    """Yield wrong calls that are not right: the example, the changes, the verdict, the text."""
    examples, rng = load_examples(), np.random.default_rng(seed)
    names = [name for name in sorted(examples) if only in name and examples[name].arguments]
    for k in range(count):
        example = examples[names[k % len(names)]]
        changes = draw_changes(example, rng)
        verdict, text = judge(example, changes, examples)
        if verdict:
            yield example, changes, verdict, text


def main() -> int:
    """Call, and print what is not right, by function."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=2016)
    parser.add_argument("--only", default="", help="part of the names of functions to call")
    parser.add_argument("--verbose", action="store_true", help="print every call")
    options = parser.parse_args()
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    found = defaultdict(list)
    os.chdir(tempfile.mkdtemp())
    for example, changes, verdict, text in fuzz(options.count, options.seed, options.only):
        what = ", ".join(f"{name} = {change.name}" for name, change in changes.items())
        found[example.name].append((verdict, f"{verdict}: {what}: {text}"))
    verdicts: dict[str, int] = defaultdict(int)
    for name in sorted(found):
        print(f"{name}: {len(found[name])}")
        for verdict, _ in found[name]:
            verdicts[verdict] += 1
        for _, text in found[name] if options.verbose else found[name][:3]:
            print(f"    {text}")
    missing = sorted(public_names() - set(load_examples()))
    if missing and not options.only:
        print(f"without a valid call: {', '.join(missing)}")
    counts = ", ".join(f"{n} {verdict}" for verdict, n in sorted(verdicts.items())) or "all right"
    print(f"{options.count} calls: {counts}")
    return int(bool(verdicts))


if __name__ == "__main__":
    sys.exit(main())
