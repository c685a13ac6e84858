"""Data of a run: named arrays with their dimensions and units, as the run file holds them."""

import hashlib
import json
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from typing import TYPE_CHECKING, Any, NamedTuple

import h5netcdf
import h5py
import numpy as np
from jaxtyping import Shaped
from numpy import ndarray as Array

from dynamics.callbacks import freeze
from dynamics.doors import checked
from dynamics.inputs import InputError, format_value, join_names

if TYPE_CHECKING:  # slow to import
    import xarray

ALWAYS_COMPRESSED = 4_000_000  # size up to which variables are [byte]
_NOT_IN_DIGEST = ("digest", "wall_s", "peak_memory_mib")
_IS_BOOL = {"dtype": "bool"}  # attribute by which xarray finds that bytes are booleans


@checked
class Variable(NamedTuple):
    """Variable of a run; a tuple that xarray takes."""

    dims: tuple[str, ...]
    values: Shaped[Array, "..."]
    attrs: Mapping[str, Any]


@checked
@dataclass(frozen=True, eq=False)
class RunData:
    """Variables of a run by name, whose arrays cannot be written to, and its attributes."""

    variables: Mapping[str, Variable]
    attrs: Mapping[str, Any]

    def __post_init__(self) -> None:
        """Protect the arrays; refuse variables that differ in size along a dimension."""
        items = self.variables.items()
        views = {name: v._replace(values=freeze(v.values.view())) for name, v in items}
        object.__setattr__(self, "variables", views)
        sizes: dict[str, int] = {}
        for name, value in self.attrs.items():
            entries = value if isinstance(value, list | tuple) else [value]
            if not all(isinstance(one, str | int | float | np.generic | Array) for one in entries):
                reason = f"must be text, a number or an array, got {format_value(value)}"
                raise InputError(f"attrs.{name}", reason)
        for name, (dims, values, _) in self.variables.items():
            if len(dims) != values.ndim:
                raise InputError(name, f"has {values.ndim} axes, and {len(dims)} dimensions")
            for dim, size in zip(dims, values.shape, strict=True):
                if sizes.setdefault(dim, size) != size:
                    text = f"{name} has {size} along {dim}, another variable {sizes[dim]}"
                    raise ValueError(text)

    @classmethod
    def from_xarray(cls, data: "xarray.Dataset") -> "RunData":
        """Take the arrays of a dataset."""
        found = {
            str(name): Variable(tuple(map(str, v.dims)), v.values, v.attrs)
            for name, v in data.variables.items()
        }
        return cls(found, {str(name): value for name, value in data.attrs.items()})

    def to_xarray(self) -> "xarray.Dataset":
        """Return the dataset of these arrays, which it shares."""
        import xarray

        return xarray.Dataset(dict(self.variables), attrs=dict(self.attrs))

    def __contains__(self, name: str) -> bool:
        return name in self.variables

    def __getitem__(self, name: str) -> Shaped[Array, "..."]:
        if name not in self.variables:
            names = join_names(self.variables, "and")
            raise InputError("name", f'there is no variable "{name}", only {names}')
        return self.variables[name].values

    def seal(self) -> "RunData":
        """Return the same data with the attribute `digest`, by which a change is found."""
        return RunData(self.variables, {**self.attrs, "digest": self.compute_digest()})

    def compute_digest(self) -> str:
        """Compute SHA-256 of the data, without the time and memory that the flight took."""
        digest = hashlib.sha256()
        attributes = {name: v for name, v in self.attrs.items() if name not in _NOT_IN_DIGEST}
        digest.update(json.dumps(attributes, sort_keys=True, default=json_default).encode())
        for name in sorted(self.variables):
            values = self[name]
            digest.update(f"{name} {values.shape}".encode())
            if values.dtype.kind in "biuf":
                digest.update(np.ascontiguousarray(values, dtype="<f8").tobytes())
            else:
                digest.update("\0".join(map(str, values.ravel())).encode())
        return digest.hexdigest()

    def to_netcdf(self) -> bytes:
        """Return the contents of a netCDF-4 file, which xarray reads."""
        # In memory: HDF5 ends the program where a disk is full.
        contents = BytesIO()
        with h5netcdf.File(contents, "w") as file:
            file.attrs.update(self.attrs)
            for name, variable in self.variables.items():
                _write_variable(file, name, variable)
        return contents.getvalue()


def json_default(value: object) -> object:
    """Convert NumPy arrays and scalars for JSON."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"cannot write {type(value).__name__} as JSON")


def _write_variable(file: Any, name: str, variable: Variable) -> None:
    dims, values, attributes = variable
    for dim, size in zip(dims, values.shape, strict=True):
        if dim not in file.dimensions:
            file.dimensions[dim] = size
    kind, options, marks = values.dtype.kind, dict[str, Any](), dict[str, str]()
    if kind == "b":
        values, marks = values.astype(np.int8), _IS_BOOL
    elif kind == "f":
        options["fillvalue"] = np.nan
    elif kind not in "iu":
        values = values.astype(h5py.string_dtype())
    if values.ndim > 1 and kind in "biuf" and _shrinks(values):
        options |= {"compression": "gzip", "compression_opts": 1, "shuffle": True}
    written = file.create_variable(name, dims, values.dtype, data=values, **options)
    written.attrs.update({**attributes, **marks})


def _shrinks(values: Array) -> bool:
    # Of much data, only what compression halves: else it takes longer than all other writing.
    if values.nbytes <= ALWAYS_COMPRESSED:
        return True
    column = values.reshape(len(values), -1)[:, values[0].size // 2].copy()
    shuffled = column.view(np.uint8).reshape(-1, values.itemsize).T.tobytes()
    return len(zlib.compress(shuffled, 1)) < len(shuffled) / 2
