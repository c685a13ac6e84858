"""The numbers of a programme as C."""

from numpy import ndarray as Array

from problems.fixed_size_avoidance import FixedSizeAvoidanceProblem
from sato.onboard.codegen import ProgramSizes


def format_model_header(programme: FixedSizeAvoidanceProblem, sizes: ProgramSizes) -> str:
    """What whoever calls the code has to know: sato_model.h, in SI units."""
    transfer = programme.transfer
    T, n, m = transfer.model.B.shape
    names: list[tuple[str, float, str]] = [
        ("STEPS", T, "T, of the flight"),
        ("STATE", n, "numbers in a state: position, then velocity"),
        ("AXES", m, "of space"),
        ("HORIZON", programme.horizon_steps, "steps with half-spaces, from the first"),
        ("ROWS", programme.rows_per_step, "half-spaces in each of these for which there is room"),
        ("LIMITED", int(programme.has_speed_limit), "whether there is a speed limit"),
        ("STEP", float(transfer.model.dt), "dt [s]"),
        ("MAX_CONTROL", float(transfer.max_control), "of each axis [m/s2]"),
        ("VARIABLES", sizes.variables, "of the programme that the solver solves"),
        ("EQUATIONS", sizes.equations, "of it"),
        ("INEQUALITIES", sizes.inequalities, "of it, the linear ones and then those of cones"),
        ("LINEAR", sizes.linear, "inequalities"),
        ("CONES", sizes.cones, "each with a row more than there are axes"),
    ]
    if programme.has_speed_limit:
        names.append(("MAX_SPEED", float(transfer.max_speed), "[m/s]"))
    return _add_include_guard(
        "SATO_MODEL_H", [f"#define SATO_{n} {v!r} /* {says} */" for n, v, says in names]
    )


def format_data_header(programme: FixedSizeAvoidanceProblem) -> str:
    """What the code alone has to know: sato_numbers.h, in SI units."""
    steps = programme.transfer.model
    arrays: list[tuple[str, Array, str]] = [
        ("A[SATO_STATE][SATO_STATE]", steps.A[0], "x[k+1] = A x[k] + B u[k] + z"),
        ("B[SATO_STATE][SATO_AXES]", steps.B[0], ""),
        ("z[SATO_STATE]", steps.z[0], ""),
        ("units[SATO_STATE]", programme.state_units, "in which states are scaled"),
        ("weight[SATO_STEPS]", programme.transfer.weights, "w, of the cost"),
    ]
    lines = [
        f"static const double sato_{name} = {_c_literal(array.tolist())};"
        + (f" /* {says} */" if says else "")
        for name, array, says in arrays
    ]
    return _add_include_guard("SATO_NUMBERS_H", lines)


def _add_include_guard(guard: str, lines: list[str]) -> str:
    return "\n".join([f"#ifndef {guard}", f"#define {guard}", "", *lines, "", "#endif", ""])


def _c_literal(part: object) -> str:
    if isinstance(part, list):
        return "{" + ", ".join(map(_c_literal, part)) + "}"
    return repr(part)
