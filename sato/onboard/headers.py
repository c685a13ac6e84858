"""C headers with the sizes and data of a program."""

from numpy import ndarray as Array

from problems.fixed_size_avoidance import FixedSizeAvoidanceProblem
from sato.onboard.codegen import ProgramSizes


def format_model_header(program: FixedSizeAvoidanceProblem, sizes: ProgramSizes) -> str:
    """Format sato_model.h, which a caller of the code needs; SI units."""
    transfer = program.transfer
    T, n, m = transfer.model.B.shape
    macros: list[tuple[str, float, str]] = [
        ("STEPS", T, "T of the flight"),
        ("STATE", n, "components of a state: position, then velocity"),
        ("AXES", m, "dimensions of space"),
        ("HORIZON", program.horizon_steps, "steps with half-spaces, from the first"),
        ("ROWS", program.rows_per_step, "largest number of half-spaces in each of these"),
        ("LIMITED", int(program.has_speed_limit), "1 where there is a speed limit"),
        ("STEP", float(transfer.model.dt), "dt [s]"),
        ("MAX_CONTROL", float(transfer.max_control), "along each axis [m/s2]"),
        ("VARIABLES", sizes.variables, "of the solver's program"),
        ("EQUATIONS", sizes.equations, "of the same"),
        ("INEQUALITIES", sizes.inequalities, "of the same: linear ones, then cones"),
        ("LINEAR", sizes.linear, "linear inequalities"),
        ("CONES", sizes.cones, "second-order cones, each with AXES + 1 rows"),
    ]
    if program.has_speed_limit:
        macros.append(("MAX_SPEED", float(transfer.max_speed), "[m/s]"))
    return _add_include_guard(
        "SATO_MODEL_H", [f"#define SATO_{n} {v!r} /* {meaning} */" for n, v, meaning in macros]
    )


def format_data_header(program: FixedSizeAvoidanceProblem) -> str:
    """Format sato_numbers.h, which only the code itself needs; SI units."""
    model = program.transfer.model
    arrays: list[tuple[str, Array, str]] = [
        ("A[SATO_STATE][SATO_STATE]", model.A[0], "x[k+1] = A x[k] + B u[k] + z"),
        ("B[SATO_STATE][SATO_AXES]", model.B[0], ""),
        ("z[SATO_STATE]", model.z[0], ""),
        ("units[SATO_STATE]", program.state_units, "units of the scaled state"),
        ("weight[SATO_STEPS]", program.transfer.weights, "w of the cost"),
    ]
    lines = [
        f"static const double sato_{name} = {_c_literal(array.tolist())};"
        + (f" /* {meaning} */" if meaning else "")
        for name, array, meaning in arrays
    ]
    return _add_include_guard("SATO_NUMBERS_H", lines)


def _add_include_guard(guard: str, lines: list[str]) -> str:
    return "\n".join([f"#ifndef {guard}", f"#define {guard}", "", *lines, "", "#endif", ""])


def _c_literal(value: object) -> str:
    if isinstance(value, list):
        return "{" + ", ".join(map(_c_literal, value)) + "}"
    return repr(value)
