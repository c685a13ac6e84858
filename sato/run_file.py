"""Contents of a run file that anybody may have made, measured before memory is taken for them."""

from collections.abc import Iterator
from math import prod
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from sato.files import check_regular, check_size
from sato.run_data import RunData
from sato.scenario.errors import InputError

MANY = 1000  # variables or attributes, more than any run has
TEXTS = 1000  # read at once
FILTERS = {"gzip", "shuffle", "fletcher32"}


def read_run_file(file: Path) -> RunData:
    """Read a netCDF-4 file; an `InputError` refuses links, data elsewhere, and too much memory."""
    import xarray

    packed = check_regular(file)
    with h5py.File(file) as opened:
        if max(len(opened), len(opened.attrs)) > MANY:
            raise InputError("", f"{file}: has more than {MANY} variables or attributes")
        variables = [_open_variable(file, opened, name) for name in opened]
        for size in (*_measure(variables), *_measure_attributes([opened, *variables], packed)):
            check_size(file, size, packed)
        for variable in variables:
            if h5py.check_string_dtype(variable.dtype) is not None:
                _check_texts(file, variable, packed)
    return RunData.from_xarray(xarray.load_dataset(file, engine="h5netcdf"))


def _open_variable(file: Path, opened: Any, name: str) -> Any:
    """Return a variable; refuse all whose values are not in the file, or of no known kind."""
    variable = opened[name] if isinstance(opened.get(name, getlink=True), h5py.HardLink) else None
    if not isinstance(variable, h5py.Dataset) or variable.external or variable.is_virtual:
        raise InputError("", f"{file}: the values of {name} are not in this file")
    is_text = h5py.check_string_dtype(variable.dtype) is not None
    if set(variable._filters) - FILTERS or not (is_text or variable.dtype.kind in "biufSV"):
        raise InputError("", f"{file}: {name} is of a kind that no run has")
    return variable


def _measure(variables: list[Any]) -> Iterator[float]:
    """Yield the memory of all variables, and of the largest chunk [byte]."""
    yield sum(float(variable.size) * variable.dtype.itemsize for variable in variables)
    yield max((prod(v.chunks or ()) * v.dtype.itemsize for v in variables), default=0)


def _measure_attributes(owners: list[Any], packed: int) -> Iterator[float]:
    for owner in owners:
        for name in owner.attrs:
            kept = owner.attrs.get_id(name)
            is_variable = kept.dtype.kind == "O"  # all of its texts may be the same, in the file
            yield prod(kept.shape) * float(packed if is_variable else kept.dtype.itemsize)


def _check_texts(file: Path, variable: Any, packed: int) -> None:
    total, step = 0, max(1, min(TEXTS, 64_000_000 // max(packed, 1)))
    for first in range(0, variable.size, step):
        total += sum(map(len, np.ravel(variable[first : first + step])))
        check_size(file, total, packed)
