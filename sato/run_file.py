"""Contents of a run file that anybody may have made, measured before memory is taken for them."""

from collections.abc import Iterator
from math import prod
from pathlib import Path
from typing import Any
from zlib import decompressobj

import h5py
import numpy as np

from sato.files import check_regular, check_size
from sato.run_data import RunData
from sato.scenario.errors import InputError

MANY = 1000  # variables or attributes, more than any run has
TEXTS = 1000  # read at once
FILTERS = {"gzip", "shuffle", "fletcher32"}
MOST_PACKED = 1032  # times its size that gzip unpacks to
DECODED = {"scale_factor", "add_offset", "_FillValue", "missing_value"}  # of which floats are made
PARSED = b"[{:,"  # in a text of JSON, each with an object [byte]:
OBJECT = 64


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
            _check_chunks(file, variable, packed)
            if h5py.check_string_dtype(variable.dtype) is not None:
                _check_texts(file, variable, packed)
    return RunData.from_xarray(xarray.load_dataset(file, engine="h5netcdf"))


def _open_variable(file: Path, opened: Any, name: str) -> Any:
    """Return a variable; refuse all whose values are not in the file, or of no known kind."""
    variable = opened[name] if isinstance(opened.get(name, getlink=True), h5py.HardLink) else None
    if not isinstance(variable, h5py.Dataset) or variable.external or variable.is_virtual:
        raise InputError("", f"{file}: the values of {name} are not in this file")
    is_text = h5py.check_string_dtype(variable.dtype) is not None
    filters = set(variable._filters)
    is_twice = len(filters) < variable.id.get_create_plist().get_nfilters()
    has_kind = variable.ndim == 1 if is_text else variable.dtype.kind in "biufSV"
    if filters - FILTERS or is_twice or not has_kind or (variable.dtype.hasobject and not is_text):
        raise InputError("", f"{file}: {name} is of a kind that no run has")
    return variable


def _measure(variables: list[Any]) -> Iterator[float]:
    """Yield the memory of all variables, and of the largest chunk [byte]."""
    yield sum(float(variable.size) * _decoded_size(variable) for variable in variables)
    yield max((prod(v.chunks or ()) * v.dtype.itemsize for v in variables), default=0)


def _decoded_size(variable: Any) -> int:
    is_bool = variable.dtype.kind == "i" and "dtype" in variable.attrs
    is_bool &= not DECODED & set(variable.attrs) and variable.attrs.get("units", "1") == "1"
    return int(variable.dtype.itemsize if is_bool else max(variable.dtype.itemsize, 8))


def _measure_attributes(owners: list[Any], packed: int) -> Iterator[float]:
    total = 0.0
    for owner in owners:
        for name in owner.attrs:
            kept = owner.attrs.get_id(name)
            fixed = float(prod(kept.shape) * kept.dtype.itemsize)
            if _has_lengths(kept.dtype):  # all of its texts may be the same, in the file
                yield prod(kept.shape) * float(packed)
            is_text = h5py.check_string_dtype(kept.dtype) is not None
            total += sum(map(len, np.ravel(owner.attrs[name]))) if is_text else fixed
            yield total


def _has_lengths(kind: Any) -> bool:
    """Tell whether values of a kind are as long as each of them says."""
    if kind.names:
        return any(_has_lengths(kind[name]) for name in kind.names)
    return bool(kind.base.hasobject) and h5py.check_ref_dtype(kind.base) is None


def _check_chunks(file: Path, variable: Any, packed: int) -> None:
    """Refuse chunks that unpack to more than they say."""
    declared = prod(variable.chunks or ()) * variable.dtype.itemsize
    if "gzip" not in variable._filters or declared == 0:
        return

    def check(chunk: Any) -> None:
        if chunk.size * MOST_PACKED > 64_000_000:
            _, raw = variable.id.read_direct_chunk(chunk.chunk_offset)
            opener = decompressobj()
            opener.decompress(raw, 2 * declared + 64)
            if opener.unconsumed_tail:
                check_size(file, float(chunk.size) * MOST_PACKED, packed)

    variable.id.chunk_iter(check)


def _check_texts(file: Path, variable: Any, packed: int) -> None:
    total, step = 0, max(1, min(TEXTS, 64_000_000 // max(packed, 1)))
    for first in range(0, variable.size, step):
        for text in variable[first : first + step]:
            total += len(text) + OBJECT * sum(map(text.count, PARSED))
        check_size(file, total, packed)
