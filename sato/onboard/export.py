"""C that solves one agent's transfer: QOCO, with code by CVXPYgen [Schaller2022, Chari2025]."""

import json
import re
import shutil
import warnings
from contextlib import redirect_stdout
from importlib.metadata import version
from importlib.resources import as_file, files
from importlib.util import find_spec
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory

from numpy import ndarray as Array

from problems.fixed_size_avoidance import FixedSizeAvoidanceProblem
from sato.atomic import replace_atomically
from sato.onboard.problem import OnboardProblem, build_problem

# Generated files that are not copied: an example, build files, and timers of other systems.
IGNORED_PATTERNS = ("build", "CMakeLists.txt", "configure", "cpg_example.c", "timer_[mw]*.c",
                    "*.in", "*.md", ".*")  # fmt: skip
SETUP_CALL = re.compile(
    r"qoco_setup\(qoco_solver, (\d+), (\d+), (\d+), P, Canon_Params\.c, A, Canon_Params\.b, "
    r"G, Canon_Params\.h, (\d+), (\d+),"
)

README = """# One agent's transfer, in C

{}.

Written by sato {} with CVXPYgen {}. `make` compiles `libsato_onboard.so`; `sato_onboard.h`
declares its function. It needs a C99 compiler, `malloc` and, on a POSIX system, `clock_gettime`.
Another number of steps needs another export. Where there is no feasible flight, the code reports
that it found none, without a proof. The code in `generated/` has licenses of its own: CVXPYgen
Apache 2.0, QOCO BSD 3-clause, QDLDL Apache 2.0, AMD BSD 3-clause.
"""


def export_c(
    scenario: str, out: str | Path, neighbors: int = 5, steps: int | None = None
) -> OnboardProblem:
    """Write C that solves the transfer of one agent of a scenario, whole or not at all.

    Args:
        scenario: Name of a built-in scenario, or a file.
        out: A new folder, or an empty one.
        neighbors: Number of neighbors for which the program has room.
        steps: Number of steps of the flight; that of the first leg if None.

    Returns:
        The problem that the code solves.

    Raises:
        ValueError: The scenario has no such problem, the folder is not empty, or the generator
            is not installed.
        OSError: The folder cannot be written.
    """
    out = Path(out)
    if find_spec("cvxpygen") is None:
        reason = "CVXPYgen, which generates the solver in C, is not installed"
        raise ValueError(f"{reason}; pip install 'cvxpygen>=1.0.2,<1.1' would do")
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise ValueError(f"{out}: exists already; --out takes a folder that is new, or empty")
    problem = build_problem(scenario, neighbors, steps)
    with replace_atomically(out) as folder, as_file(files("sato.onboard") / "c") as sources:
        shutil.copytree(sources, folder)
        sizes = generate_solver(problem.program, folder / "generated")
        versions = version("sato-swarm"), version("cvxpygen")
        for name, text in (
            ("sato_model.h", format_model_header(problem.program, sizes)),
            ("sato_numbers.h", format_data_header(problem.program)),
            ("README.md", README.format(describe(problem), *versions)),
        ):
            (folder / name).write_text(text, encoding="utf-8")
    return problem


def describe(problem: OnboardProblem) -> str:
    """Describe in a sentence the flights that the code can plan."""
    program, transfer = problem.program, problem.program.transfer
    limit = f"the speed limit of {transfer.max_speed:g} m/s"
    return (
        f"{problem.scenario}: flights of {len(transfer.model)} steps with "
        f"{limit if program.has_speed_limit else 'no speed limit'}, at most "
        f"{transfer.max_control:g} m/s² an axis and steps of {transfer.model.dt:g} s, and "
        f"{program.rows_per_step} half-spaces in each of the first {program.horizon_steps}, "
        f"which is room for {problem.neighbors} neighbors"
    )


def generate_solver(problem: FixedSizeAvoidanceProblem, folder: Path) -> list[str]:
    """Write the solver into a folder that does not exist yet.

    It has numbers of variables, inequalities, equations, linear inequalities and cones.
    """
    from cvxpygen import cpg

    with TemporaryDirectory(dir=folder.parent) as whole:
        with warnings.catch_warnings(), redirect_stdout(StringIO()):
            warnings.simplefilter("ignore")  # they concern its own dependencies
            cpg.generate_code(problem.to_cvxpy(), code_dir=whole, solver="QOCO", wrapper=False)
        shutil.copytree(Path(whole, "c"), folder, ignore=shutil.ignore_patterns(*IGNORED_PATTERNS))
    setup_call = SETUP_CALL.search((folder / "src" / "cpg_solve.c").read_text(encoding="utf-8"))
    if setup_call is None:
        raise RuntimeError("this version of CVXPYgen generates other C than version 1.0")
    return list(setup_call.groups())


def format_model_header(program: FixedSizeAvoidanceProblem, sizes: list[str]) -> str:
    """Format sato_model.h, which a caller of the code needs; SI units."""
    transfer = program.transfer
    T, n, m = transfer.model.B.shape
    variables, inequalities, equations, linear, cones = sizes
    max_speed = f"#define SATO_MAX_SPEED {float(transfer.max_speed)!r} /* [m/s] */"
    return f"""#ifndef SATO_MODEL_H
#define SATO_MODEL_H

#define SATO_STEPS {T} /* T of the flight */
#define SATO_STATE {n} /* components of a state: position, then velocity */
#define SATO_AXES {m} /* dimensions of space */
#define SATO_HORIZON {program.horizon_steps} /* steps with half-spaces, from the first */
#define SATO_ROWS {program.rows_per_step} /* largest number of half-spaces in each of these */
#define SATO_LIMITED {int(program.has_speed_limit)} /* 1 where there is a speed limit */
#define SATO_STEP {float(transfer.model.dt)!r} /* dt [s] */
#define SATO_MAX_CONTROL {float(transfer.max_control)!r} /* along each axis [m/s2] */
#define SATO_VARIABLES {variables} /* of the solver's program */
#define SATO_EQUATIONS {equations} /* of the same */
#define SATO_INEQUALITIES {inequalities} /* of the same: linear ones, then cones */
#define SATO_LINEAR {linear} /* linear inequalities */
#define SATO_CONES {cones} /* second-order cones, each with AXES + 1 rows */
{max_speed if program.has_speed_limit else ""}
#endif
"""


def format_data_header(program: FixedSizeAvoidanceProblem) -> str:
    """Format sato_numbers.h, which only the code itself needs; SI units."""
    model = program.transfer.model
    return f"""#ifndef SATO_NUMBERS_H
#define SATO_NUMBERS_H

/* x[k+1] = A x[k] + B u[k] + z */
static const double sato_A[SATO_STATE][SATO_STATE] = {_c_literal(model.A[0])};
static const double sato_B[SATO_STATE][SATO_AXES] = {_c_literal(model.B[0])};
static const double sato_z[SATO_STATE] = {_c_literal(model.z[0])};
/* units of the scaled state, and w of the cost */
static const double sato_units[SATO_STATE] = {_c_literal(program.state_units)};
static const double sato_weight[SATO_STEPS] = {_c_literal(program.transfer.weights)};

#endif
"""


def _c_literal(array: Array) -> str:
    return json.dumps(array.tolist()).replace("[", "{").replace("]", "}")
