"""Read and build mutated built-in scenarios: python scripts/fuzz_scenarios.py --count 2000.

Whatever is in a file, it is drawn, or refused by `ScenarioError` or `InputError`, within 10 s
of CPU time.
Exit code 1, and the mutations, where one is not.
"""

import argparse
import copy
import os
import resource
import sys
import tomllib
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.random import Generator

import sato

LIMIT_S = 10.0
MEMORY = 8 * 2**30  # that a case may address [byte]
INTEGERS: list[Any] = [0, 1, -1, 2, 3, 4, 7, 30, 100, 1000, 5000, 10**6, 2**63, 10**400]
FLOATS: list[Any] = [
    0.0,
    -0.0,
    0.5,
    1.0,
    -1.0,
    7.0,
    1e-9,
    1e-300,
    5e-324,
    1e4,
    1e9,
    -1e9,
    1e20,
    1e300,
]
FLOATS += [float("nan"), float("inf"), -float("inf")]
TEXTS = ["", " ", "auto", "random", "😀", "Ω\u202eλ₂", "\x00", "a" * 10_000, "../..", "nan", "1e9"]
TABLES: list[Any] = [{}, {"kind": "random"}, {"kind": "points"}, {"kind": []}, {"": 0}]
LISTS: list[Any] = [[], [[]], [0.0, 1.0], [[0.0, 1.0]], [[1.0], [2.0, 3.0]], [None], [{}]]
OTHERS: list[Any] = [True, False, *TEXTS, *TABLES, *LISTS, list(range(3000)), [[0.5, 0.5]] * 500]

KINDS = ("number", "scale", "other", "delete", "extra", "swap", "repeat")
SHARES = (0.3, 0.3, 0.1, 0.05, 0.05, 0.1, 0.1)

Place = tuple[Any, Any]  # a table or list, and a key or index in it


def draw_place(value: Any, rng: Generator) -> Place:
    """Draw a place in nested tables and lists, going in step by step."""
    keys = list(value) if isinstance(value, dict) else range(len(value))
    key = keys[rng.integers(len(keys))]
    inner = value[key]
    if isinstance(inner, dict | list) and inner and rng.random() < 0.9:
        return draw_place(inner, rng)
    return value, key


def mutate(scenario: dict[str, Any], rng: Generator) -> tuple[dict[str, Any], list[str]]:
    """Return a scenario with one to three changes, and what they are."""
    changed = copy.deepcopy(scenario)
    told = []
    for _ in range(rng.choice([1, 2, 3], p=[0.6, 0.3, 0.1])):
        holder, key = draw_place(changed, rng)
        kind, was = rng.choice(KINDS, p=SHARES), holder[key]
        is_number = type(was) in (int, float)
        if kind == "number" and is_number:
            values = INTEGERS if isinstance(was, int) else FLOATS
            holder[key] = values[rng.integers(len(values))]
        elif kind in ("scale", "number", "other") and is_number and rng.random() < 0.8:
            power = rng.integers(-9, 10) if rng.random() < 0.3 else rng.uniform(-1, 1)
            holder[key] = type(was)(was * 10.0**power)
        elif kind == "delete":
            del holder[key]
        elif kind == "extra" and isinstance(holder, dict):
            name = f"{key}s" if rng.random() < 0.5 else TEXTS[rng.integers(len(TEXTS))]
            holder[name] = copy.deepcopy(was)
        elif kind == "swap":
            other, name = draw_place(changed, rng)
            holder[key] = copy.deepcopy(other[name])
        elif kind == "repeat" and isinstance(was, list):
            holder[key] = was * int(10.0 ** rng.integers(0, 4))
        else:
            holder[key] = copy.deepcopy(OTHERS[rng.integers(len(OTHERS))])
        told.append(f"{kind} {key}: {_short(was)} -> {_short(_get(holder, key))}")
    return changed, told


def _get(holder: Any, key: Any) -> Any:
    try:
        return holder[key]
    except (KeyError, IndexError):
        return "nothing"


def _short(value: Any) -> str:
    text = ascii(value) if not isinstance(value, int) or abs(value) < 2**64 else "a large integer"
    return text if len(text) < 60 else f"{text[:60]}…"


def base_scenarios() -> dict[str, dict[str, Any]]:
    """Return the built-in scenarios, with all their defaults."""
    return {name: tomllib.loads(sato.read(name).to_toml()) for name in sato.scenarios()}


def cases(seed: int, count: int) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield mutated scenarios, with their name and what was changed."""
    bases = base_scenarios()
    names = sorted(bases)
    for k in range(count):
        rng = np.random.default_rng([seed, k])
        name = names[k % len(names)]
        changed, told = mutate(bases[name], rng)
        yield f"{k} {name}: {'; '.join(told)}", changed


def build(scenario: dict[str, Any]) -> str:
    """Read and draw a scenario; return the sentence of its refusal, empty without one."""
    try:
        sato.from_dict(scenario).draw(np.random.default_rng(0))
    except (sato.InputError, sato.ScenarioError) as error:
        return str(error) or "no sentence"
    return ""


def run_apart(task: Callable[[], str], limit: float) -> tuple[str, str, float]:
    """Run a task in a process of its own; return how it ended, its text, and its CPU time [s]."""
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        resource.setrlimit(resource.RLIMIT_CPU, (int(limit) + 1, int(limit) + 1))
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        warnings.simplefilter("error")
        try:
            text = task()
            code = 1 if text else 0
        except BaseException:
            text, code = traceback.format_exc(), 2
        os.write(write, text[-60_000:].encode(errors="replace"))
        os._exit(code)
    os.close(write)
    with open(read, errors="replace") as pipe:
        text = pipe.read()
    _, status, used = os.wait4(child, 0)
    code = os.waitstatus_to_exitcode(status)
    end = {0: "built", 1: "refused", 2: "exception"}.get(code, f"killed by {-code}")
    return end, text, used.ru_utime + used.ru_stime


def main() -> int:
    """Run the mutations and print those that are neither built nor refused in time."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", type=int, help="a number of a mutation")
    given = parser.parse_args()
    for name in sato.scenarios():  # what is compiled is compiled here
        sato.read(name).draw(np.random.default_rng(0))
    ends: Counter[str] = Counter()
    worst = 0.0
    for k, (told, scenario) in enumerate(cases(given.seed, given.count)):
        if given.only not in (None, k):
            continue
        end, text, took = run_apart(lambda given=scenario: build(given), LIMIT_S)
        worst = max(worst, took)
        end = end if took <= LIMIT_S else "too slow"
        ends[end] += 1
        if end not in ("built", "refused"):
            print(f"{end} ({took:.1f} s): {told}\n{text}", flush=True)
        elif given.only is not None:
            print(told, "\n", text)
    print(f"{dict(ends)}, at most {worst:.1f} s")
    return 0 if set(ends) <= {"built", "refused"} else 1


if __name__ == "__main__":
    sys.exit(main())
