"""Regenerate the problem families.

    python scripts/write_problem_families.py [FAMILY …] --out DIR

Each is drawn from runs of a scenario, answered by two solvers, and written with its answers
and the seed to problems/families. The same versions of the libraries give the same files.
"""

from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer
from problem_families import FAMILIES, SEED, UnsolvedFamily
from threadpoolctl import threadpool_limits

import problems.families
from problems.conic import ConicProgram, ConicSolution, Unsolved, verify_ray
from problems.families import SIZES
from problems.solvers import load_adapters

ANSWER_TOLERANCE = 1e-9  # asked of an answer
AGREEMENT_TOLERANCE = 1e-6  # by which the optima of two solvers may differ, relative


class ReferenceSolution(NamedTuple):
    """Solution on which two solvers agree."""

    reference: float
    difference: float
    x: np.ndarray
    y: np.ndarray


def reference_solvers(problem: ConicProgram) -> tuple[str, str]:
    """Return two solvers that are accurate to many digits on a problem."""
    if "semidefinite" in problem.cone_types:
        return "clarabel", "scs"
    return ("clarabel", "ecos") if "second-order" in problem.cone_types else ("highs", "clarabel")


def solve_reference(problem: ConicProgram, feasible: bool) -> ReferenceSolution:
    """Return the better of two solutions, or of two certificates of infeasibility.

    Raises:
        Unsolved: The solvers disagree, or neither is fine enough.
    """
    known = load_adapters()
    claims = [
        known[name].open_session(problem, ANSWER_TOLERANCE).solve(problem.b)
        for name in reference_solvers(problem)
    ]
    if not feasible:
        rays = [verify_ray(problem, claim.y) for claim in claims if claim.y is not None]
        if len(rays) < len(claims) or any(doubt for _, doubt in rays):
            raise Unsolved(problem, f"no two proofs: {claims} {rays}")
        y = min((ray for ray, _ in rays), key=lambda y: float(np.abs(problem.A.T @ y).sum()))
        return ReferenceSolution(np.nan, 0.0, np.full(len(problem.q), np.nan), y)
    answers = []
    for claim in claims:
        if claim.x is None or claim.y is None:
            raise Unsolved(problem, f"a solver stopped: {claim.message}")
        answers.append(ConicSolution.evaluate(problem, claim.x, claim.y))
    values = [problem.cost(answer.x) for answer in answers]
    best = min(answers, key=lambda answer: answer.max_residual)
    reference = problem.cost(best.x)
    agreed = abs(values[0] - values[1]) / (1 + abs(reference))
    if not (best.max_residual <= ANSWER_TOLERANCE and agreed <= AGREEMENT_TOLERANCE):
        raise Unsolved(problem, f"off by {best.max_residual:.1e}, the optima by {agreed:.1e}")
    return ReferenceSolution(reference, agreed, best.x, best.y)


def pack_family(drawn: UnsolvedFamily) -> dict[str, Any]:
    """Return the stored form of the problems and their solutions."""
    shared: list[ConicProgram] = []
    program = []
    for problem in drawn.problems:
        same = (k for k, other in enumerate(shared) if problem.differs_in_b_only(other))
        program.append(next(same, len(shared)))
        if program[-1] == len(shared):
            shared.append(problem)
    settled = [solve_reference(problem, drawn.is_feasible) for problem in drawn.problems]
    stored: dict[str, Any] = {
        "source": drawn.source,
        "seed": SEED,
        "solvers": reference_solvers(drawn.problems[0]),
        "programs": len(shared),
        "program": program,
        "feasible": [drawn.is_feasible] * len(settled),
        "reference": [answer.reference for answer in settled],
        "agreed": [answer.difference for answer in settled],
    }
    for k, problem in enumerate(shared):
        A = problem.A.copy()
        A.eliminate_zeros()
        stored |= {f"q{k}": problem.q, f"values{k}": A.data}
        if problem.P is not None:  # which is diagonal
            stored[f"curvature{k}"] = problem.P.diagonal()
        stored |= {f"rows{k}": A.indices.astype(np.int32), f"starts{k}": A.indptr.astype(np.int32)}
        stored |= {f"linear{k}": [problem.zero, problem.nonnegative]}
        stored |= {f"cones{k}": np.array(problem.soc_sizes, int)}
        stored |= {f"matrices{k}": np.array(problem.psd_orders, int)}
    for i, (problem, answer) in enumerate(zip(drawn.problems, settled, strict=True)):
        stored |= {f"b{i}": problem.b, f"x{i}": answer.x, f"y{i}": answer.y}
    return stored


def main(
    family: Annotated[list[str] | None, typer.Argument(help="all without one")] = None,
    out: Annotated[Path, typer.Option(help="folder")] = Path(problems.families.__file__).parent,
    size: Annotated[list[str] | None, typer.Option(help="small, medium, large; all")] = None,
) -> None:
    """Draw, solve and write the families."""
    if unknown := [s for s in size or () if s not in SIZES]:
        raise typer.BadParameter(f"there is no size {unknown[0]}; there are {', '.join(SIZES)}")
    for name in family or FAMILIES:
        if name not in FAMILIES:
            raise typer.BadParameter(f"there is no {name}; there are {', '.join(FAMILIES)}")
        for each in [s for s in SIZES if not size or s in size]:
            stored = pack_family(FAMILIES[name](each))
            file = out / f"{name}-{each}.npz"
            np.savez_compressed(file, **stored)
            worst = max(stored["agreed"])
            print(f"{file.name}: {file.stat().st_size / 1e3:.0f} kB, agreed to {worst:.0e}")


if __name__ == "__main__":
    with threadpool_limits(1):
        typer.run(main)
