"""Public functions and classes check their arguments by the annotations."""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import inf, nan
from typing import Annotated, Literal, NamedTuple

import numpy as np
import pytest
import scipy.sparse
from annotated_types import Ge, Gt
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from dynamics.doors import MAY_BE_NAN, checked
from dynamics.inputs import InputError

HUGE = 10**400  # no float


@checked
def move(
    x: Float[Array, "agents n"],
    dt: Annotated[float, Gt(0)],
    u: Float[Array, "agents T n"] | None = None,
    ends: Float[Array, "T+1 2*n"] | None = None,
    most: float | Float[Array, " n"] = inf,
    count: Annotated[int, Ge(0)] = 1,
    norm: Literal[1, 2, "inf"] = 1,
    is_joint: bool = False,
    name: str = "",
    cost: Callable[[Array], float] | None = None,
    targets: Annotated[Float[Array, "*k n"] | None, MAY_BE_NAN] = None,
    times: Sequence[float] = (),
    chosen: Int[Array, " agents"] | None = None,
    graph: Bool[Array, "agents agents"] | None = None,
    bounds: tuple[float, float] = (0.0, 1.0),
    table: dict[str, float] | None = None,
) -> tuple[object, ...]:
    return x, dt, u, ends, most, count, norm, is_joint, name, cost, targets, times, chosen, graph


X = np.zeros((3, 2))
ODD = (object(), object, lambda: 0, (i for i in range(3)), {}, b"1", "1", "x" * 10_000, 1 + 0j, nan)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("x", [0.0, 1.0], r"x: must be an array of finite numbers of shape \(agents, n\), got"),
        ("x", None, "got None"),
        ("x", [[nan, 0.0]], r"got an array of shape \(1, 2\) with nan at \[0, 0\]"),
        ("x", X + 1j, "dtype complex128"),
        ("x", X > 0, "dtype bool"),
        ("x", [[HUGE, 0]], "dtype object"),
        ("x", scipy.sparse.csr_array(X), r"a sparse matrix; its toarray\(\) would do"),
        ("x", [[1e200, 0]], "between 1e-30 and 1e[+]30"),
        ("x", np.ma.masked_array(X), "masked"),
        ("x", [[0.0], [0.0, 1.0]], "rows of one length"),
        ("dt", True, "dt: must be a finite number above 0, got true"),
        ("dt", 0, "got 0"),
        ("dt", nan, "got nan"),
        ("dt", inf, "got inf"),
        ("dt", HUGE, "got an integer of more than 30 digits"),
        ("dt", 1 + 0j, "got .1.0j"),
        ("dt", "1", 'got "1"'),
        ("u", np.zeros((2, 4, 2)), r"shape \(3, T, 2\), got an array of shape \(2, 4, 2\)"),
        ("ends", np.zeros((4, 3)), r"shape \(T\+1, 4\)"),
        ("most", nan, r"must be a number or an array .* of shape \(2,\), got nan"),
        ("most", [1.0, 2.0, 3.0], r"of shape \(2,\), got an array of shape \(3,\)"),
        ("count", 1.0, "count: must be an integer at least 0, got 1.0"),
        ("count", True, "integer"),
        ("count", -1, "at least 0, got -1"),
        ("count", HUGE, "at most 1e.09"),
        ("norm", True, 'must be 1, 2 or "inf"'),
        ("norm", 3, "got 3"),
        ("norm", 1.5, "got 1.5"),
        ("norm", nan, "got nan"),
        ("dt", {}, "must be a finite number above 0, got a table"),
        ("x", {}, 'column "x" is missing; there are none'),
        ("is_joint", 1, "must be True or False, got 1"),
        ("name", b"a", "must be text"),
        ("cost", 3, "must be a function"),
        ("targets", np.zeros((2, 3)), r"shape \(\.\.\., 2\)"),
        ("times", [0.0, "1"], "times.1: must be a finite number"),
        ("chosen", [0.0, 1.0, 2.0], "integers"),
        ("graph", np.full((3, 3), 2), "True and False"),
        ("bounds", (0.0,), "2 values"),
        ("bounds", (0.0, HUGE), "bounds.1"),
        ("table", {"a": "b"}, "table.a"),
        ("table", [1], "must be a dict"),
    ],
    ids=lambda value: value if isinstance(value, str) else type(value).__name__,
)
def test_wrong_arguments_are_refused_by_name(name, value, message):
    with pytest.raises(InputError, match=message) as caught:
        move(**{"x": X, "dt": 1.0, name: value})
    assert caught.value.key.startswith(name)


@pytest.mark.parametrize("name", ["x", "dt", "u", "count", "norm", "is_joint", "times", "table"])
def test_odd_objects_are_refused(name):
    for value in ODD:
        if not (name == "table" and value == {}):
            with pytest.raises(InputError, match=f"^{name}"):
                move(**{"x": X, "dt": 1.0, name: value})


def test_lists_and_numbers_of_numpy_are_converted():
    result = move([[1, 2]], np.int64(2), most=[1, 2], count=np.int32(3), chosen=[0], graph=[[0]])
    x, dt, u, _, most, count, *_, chosen, graph = result
    assert x.dtype == most.dtype == float and x.tolist() == [[1.0, 2.0]]
    assert type(dt) is float and type(count) is int and u is None
    assert chosen.dtype == np.int64 and graph.dtype == bool


@pytest.mark.parametrize(("given", "norm"), [(inf, "inf"), (2.0, 2), (np.int64(2), 2)])
def test_norms_are_taken_as_numpy_takes_them(given, norm):
    assert move(X, 1.0, norm=given)[6] == norm


def test_fractions_are_numbers_and_no_integers():
    assert move(X, Fraction(1, 2))[1] == 0.5
    for name, value in (("dt", Fraction(10**400)), ("dt", Fraction(-1, 2)), ("count", Fraction(2))):
        with pytest.raises(InputError, match=f"^{name}: must be .* got an object of type Fraction"):
            move(**{"x": X, "dt": 1.0, name: value})


def test_an_array_of_floats_passes_as_it_is():
    assert move(X, 1.0, targets=(a := np.full((4, 2), nan)))[10] is a


def test_only_a_default_that_is_infinite_lets_infinity_pass():
    assert move(X, 1.0, most=inf)[4] == inf


@checked
@dataclass(frozen=True, eq=False)
class Model:
    """Linear steps."""

    A: Float[Array, "n n"]
    gain: float = 1.0

    @property
    def array_sizes(self) -> dict[str, int]:
        return {"n": len(self.A)}

    def step(self, x: Float[Array, "*k n"]) -> Array:
        return x @ self.A.T

    @classmethod
    def scaled(cls, size: Annotated[float, Gt(0)]) -> "Model":
        return cls(size * np.eye(2))

    def within(self) -> Array:
        return self.step("anything")


@checked
@dataclass(frozen=True, repr=False)
class Told:
    """Value with a text of its own."""

    gain: float = 1.0

    def __repr__(self) -> str:
        return "told"


def test_a_queue_is_taken_for_a_list():
    assert move(X, 1.0, times=deque([1, 2]))[11] == (1.0, 2.0)


def test_a_text_of_its_own_is_kept():
    assert repr(Told()) == "told"


@checked
class Start(NamedTuple):
    """Start of a vehicle."""

    position: Float[Array, " n"]
    yaw: float = 0.0


@checked
def solve(model: Model, x: Float[Array, " n"]) -> float:
    return float(model.step(x).sum())


def test_an_object_keeps_arrays_that_nobody_can_change():
    A = np.eye(2)
    model = Model(A)
    A[0, 0] = nan
    assert model.A[0, 0] == 1.0 and not model.A.flags.writeable


def test_constructors_and_methods_are_doors():
    with pytest.raises(InputError, match="A: must be an array"):
        Model([1.0])
    with pytest.raises(InputError, match="size: must be a finite number above 0"):
        Model.scaled(-1)
    with pytest.raises(InputError, match="yaw"):
        Start([0.0], yaw=True)
    assert Start([1, 2]).position.dtype == float
    assert Start([1, 2])._replace(yaw=2.0).yaw == 2.0


def test_an_object_gives_the_sizes_of_its_axes():
    with pytest.raises(
        InputError, match=r"x: .* shape \(\.\.\., 2\), got an array of shape \(3,\)"
    ):
        Model.scaled(1.0).step(np.zeros(3))
    with pytest.raises(InputError, match=r"x: .* of shape \(2,\)"):
        solve(Model.scaled(1.0), [1.0])
    with pytest.raises(InputError, match="model: must be a Model, got the class Model"):
        solve(Model, [1.0])


def test_missing_and_unknown_arguments_are_named_by_python():
    with pytest.raises(TypeError, match="missing 1 required"):
        move(X)
    with pytest.raises(TypeError, match="unexpected keyword"):
        Model(np.eye(2), wrong=1)
