"""Valid calls of the public functions, classes and methods of `dynamics` and `problems`."""

from collections.abc import Iterator
from typing import Any

import numpy as np

Call = tuple[Any, dict[str, Any]]

# Changes that an argument takes though they look wrong: "Class.method.argument": names of changes.
ALLOWED: dict[str, tuple[str, ...]] = {
    f"{method}.{name}": ("nan entry",)  # absent agents
    for method in (
        "DiscreteModel.simulate",
        "DiscreteModel.coast_to_end",
        "InertialPlant.propagate",
        "J2.jacobian",
        "J2.rate",
        "LinearModel.rate",
        "LinearPlant.propagate",
        "NonlinearPlant.propagate",
        "SymbolicModel.jacobian",
        "SymbolicModel.rate",
        "control_points",
        "interpolation_error",
        "linearize_along",
        "separations",
    )
    for name in ("x", "u", "position", "velocity")
} | {
    "align.measured": ("nan entry",),
    "algebraic_connectivity.weight": ("bool entries",),
    "laplacian.weight": ("bool entries",),
    "are_hulls_separated.relative": ("nan entry",),  # from what is nowhere nothing is separated
    "GainMatrix.bound_xy": ("inf",),  # proves nothing
    "GainMatrix.bound_z": ("inf",),
    **{
        f"ConicSolution.{name}": ("nan", "inf", "nan entry", "inf entry")  # of a solver that fails
        for name in ("x", "y", "primal_residual", "dual_residual", "gap")
    },
    **{
        f"{name}": ("nan entry", "inf entry")
        for name in (
            "SolverResult.x",
            "SolverResult.y",
            "ConicSolution.evaluate.x",
            "ConicSolution.evaluate.y",
            "verify_ray.ray",
            "GainProblem.rate_bound.Y",
        )
    },
}


def list_calls() -> Iterator[Call]:
    """List a function, a class or a bound method, and its arguments by name."""
    yield from _orbits()
    yield from _models()
    yield from _transfers()
    yield from _programs()
    yield from _formations()


def _orbits() -> Iterator[Call]:
    from dynamics import LVLH, Atmosphere, Orbit, inertial_state, invariant_velocity, to_polar_nodal
    from dynamics.units import Unit

    orbit = Orbit.from_elements(7e6, inclination=1.0)
    elements = {"raan": 0.1, "inclination": 1.0, "mu": orbit.mu, "k_J2": orbit.k_J2}
    yield Unit, {"suffix": "m_s"}
    yield Orbit, {"r": 7e6, "v_x": 0.0, "h": orbit.h, "arg_latitude": 0.2, **elements}
    classical = {"eccentricity": 0.01, "arg_perigee": 0.1, "true_anomaly": 0.2}
    yield Orbit.from_elements, {"semi_major_axis": 7e6, **classical, **elements}
    yield orbit.elements_at, {"t": np.array([0.0, 10.0])}
    position = np.array([[100.0, 20.0, -30.0], [0.0, 50.0, 0.0]])
    yield invariant_velocity, {"orbit": orbit, "position": position, "t": 10.0}
    polar = np.array(orbit.initial_elements)
    state = inertial_state(polar)
    yield inertial_state, {"chief": polar}
    yield to_polar_nodal, {"state": state}
    frame = LVLH.from_state(state)
    yield LVLH, {"chief_state": state, "axes": frame.axes, "omega": frame.omega}
    yield LVLH.from_state, {"chief": state, "acceleration": np.array([0.0, 0.0, -1e-3])}
    yield LVLH.from_polar_nodal, {"chief": polar, "k_J2": orbit.k_J2}
    x = np.array([[100.0, 20.0, -30.0, 0.1, 0.0, 0.2], [0.0, 50.0, 0.0, 0.0, 0.0, 0.0]])
    yield frame.to_inertial, {"x": x}
    yield frame.from_inertial, {"state": frame.to_inertial(x)}
    yield frame.to_offset, {"x": x}
    yield frame.from_offset, {"offset": x}
    air = Atmosphere.from_altitude(500e3)
    density = {"reference_density": 1e-12, "reference_altitude": 5e5, "scale_height": 6e4}
    yield Atmosphere, {**density, "rotation_rate": 7e-5}
    yield Atmosphere.from_altitude, {"altitude": 500e3}
    yield air.density_at, {"position": state[:3]}
    yield air.drag_acceleration, {"state": state, "ballistic_coefficient": 0.01}


def _models() -> Iterator[Call]:
    from dynamics import (
        J2,
        ClohessyWiltshire,
        DoubleIntegrator,
        Orbit,
        SchweighartSedwick,
        SymbolicModel,
        TschaunerHempel,
        discretize_zoh,
        linearize_along,
    )
    from dynamics.model import LinearizedModel

    orbit = Orbit.from_elements(7e6, eccentricity=0.01, inclination=1.0)
    position = np.array([[100.0, 20.0, -30.0], [0.0, 50.0, 0.0]])
    x = np.array([[100.0, 20.0, -30.0, 0.1, 0.0, 0.2], [0.0, 50.0, 0.0, 0.0, 0.0, 0.0]])
    u = np.full((2, 3), 1e-4)
    motion = {"t": 10.0, "x": x, "u": u}
    hill = ClohessyWiltshire(1e-3)
    yield ClohessyWiltshire, {"n": 1e-3}
    yield ClohessyWiltshire.from_orbit, {"orbit": orbit}
    yield hill.A, {"t": 10.0}
    yield hill.B, {"t": 10.0}
    yield hill.z, {"t": 10.0}
    yield hill.matrices, {"times": np.array([0.0, 10.0])}
    yield hill.rate, motion
    yield hill.bounded_velocity, {"position": position, "t": 0.0}
    yield hill.centered_velocity, {"position": position, "t": 0.0}
    shared = {"inclination": 1.0, "mu": orbit.mu, "k_J2": orbit.k_J2}
    yield SchweighartSedwick, {"radius": 7e6, **shared}
    yield SchweighartSedwick.from_orbit, {"orbit": orbit}
    plane = DoubleIntegrator(2)
    yield DoubleIntegrator, {"axes": 2}
    yield plane.A, {"t": 0.0}
    ellipse = TschaunerHempel(orbit)
    yield TschaunerHempel, {"orbit": orbit}
    yield ellipse.A, {"t": 10.0}
    yield ellipse.matrices, {"times": np.array([0.0, 10.0])}
    yield ellipse.bounded_velocity, {"position": position, "t": 10.0}
    exact = J2(orbit)
    yield J2, {"orbit": orbit}
    yield exact.rate, motion
    yield exact.jacobian, motion
    linear = LinearizedModel(exact)
    yield LinearizedModel, {"model": exact}
    yield linear.A, {"t": 10.0}
    yield linear.B, {"t": 10.0}
    yield linear.z, {"t": 10.0}
    yield linear.matrices, {"times": np.array([0.0, 10.0])}
    yield from _symbolic(SymbolicModel)
    yield discretize_zoh, {"model": hill, "dt": 10.0, "count": 3, "t0": 0.0}
    many = {"x": np.repeat(x[:, None], 3, axis=1), "u": np.repeat(u[:, None], 2, axis=1)}
    yield linearize_along, {"model": exact, **many, "dt": 10.0, "t0": 0.0}
    yield from _steps(discretize_zoh(hill, 10.0, 3), x)
    yield from _plants(orbit, hill, exact, x, u)


def _symbolic(kind: Any) -> Iterator[Call]:
    import casadi

    def expression(t: Any, x: Any, u: Any) -> Any:
        return casadi.vertcat(x[2:], u - 0.1 * x[2:])

    model = kind(2, expression)
    motion = {"t": 0.0, "x": np.arange(8.0).reshape(2, 4), "u": np.ones((2, 2))}
    yield kind, {"axes": 2, "expression": expression}
    yield model.rate, motion
    yield model.jacobian, motion


def _steps(steps: Any, x: Any) -> Iterator[Call]:
    from dynamics import DiscreteModel

    own = DiscreteModel(*(np.stack([part] * 2) for part in (steps.A, steps.B, steps.z)), steps.dt)
    yield DiscreteModel, {"A": steps.A, "B": steps.B, "z": steps.z, "dt": 10.0}
    yield own.for_agent, {"agent": 1}
    yield steps.respond, {"shares": np.array([1.0, 0.5, 1.0])}
    yield steps.simulate, {"x": x, "u": np.full((2, 3, 3), 1e-4)}
    yield steps.coast_to_end, {"x": x}


def _plants(orbit: Any, hill: Any, exact: Any, x: Any, u: Any) -> Iterator[Call]:
    from dynamics import Atmosphere, InertialPlant, LinearPlant, NonlinearPlant, propagate
    from dynamics.coordinate_frames import inertial_state
    from dynamics.forces import Forces

    motion = {"x": x, "u": u, "t": 0.0, "dt": 10.0, "substeps": 2}
    air = Atmosphere.from_altitude(500e3)
    inertial = InertialPlant(orbit)
    drag = {"ballistic_coefficient": 0.01, "chief_ballistic_coefficient": 0.02}
    yield InertialPlant, {"chief_orbit": orbit, **drag, "atmosphere": air}
    yield inertial.propagate, motion
    yield inertial.chief_elements, {"t": 10.0}
    linear = LinearPlant(hill, orbit)
    yield LinearPlant, {"model": hill, "chief_orbit": orbit}
    yield linear.propagate, motion
    yield linear.chief_elements, {"t": 10.0}
    yield NonlinearPlant, {"model": exact}
    yield NonlinearPlant(exact).propagate, motion
    state = inertial_state(np.array([orbit.initial_elements]))
    forces = {"forces": Forces(atmosphere=air), "ballistic_coefficient": 0.01, "accuracy": 1e-6}
    yield propagate, {"state": state, "times": np.array([0.0, 60.0]), **forces}
    yield from _geometry(hill)


def _geometry(hill: Any) -> Iterator[Call]:
    from dynamics import trajectory_geometry as geometry
    from dynamics.vehicle import rotate_by_yaw

    position = np.arange(12.0).reshape(3, 2, 2) ** 1.5
    velocity, alive = np.ones((3, 2, 2)), np.ones((3, 2), dtype=bool)
    pieces = geometry.control_points(position.swapaxes(0, 1), velocity.swapaxes(0, 1), 1.0)
    path = {"position": position, "velocity": velocity, "h": 1.0}
    yield geometry.control_points, path
    yield geometry.evaluate_bezier, {"points": pieces[0], "fraction": 0.5}
    yield geometry.divide_pieces, {"points": pieces[0], "parts": 2}
    yield geometry.hull_distance, {"points": pieces[0]}
    more = {"alive": alive, "radii": np.array([1.0, 2.0]), "is_adrift": ~alive}
    yield geometry.separations, {**path, **more}
    states, controls = np.arange(18.0).reshape(1, 3, 6), np.full((1, 2, 3), 0.1)
    error = {"model": hill, "x": states, "u": controls, "h": 10.0, "t0": 0.0}
    yield geometry.interpolation_error, error
    yield rotate_by_yaw, {"vectors": np.array([[1.0, 2.0, 3.0]]), "yaw": np.array([0.1])}


def _transfers() -> Iterator[Call]:
    from dynamics import DoubleIntegrator, discretize_zoh
    from problems import (
        AvoidanceProblem,
        AvoidanceResult,
        Trajectory,
        TransferCosts,
        TransferProblem,
        auction_cost,
        compute_transfer_costs,
        minimum_fuel,
        solve_minimum_fuel,
        solve_transfer,
    )
    from problems.solvers.verified import VerifiedSolver

    steps = discretize_zoh(DoubleIntegrator(2), 1.0, 6)
    transfer = TransferProblem(steps, 0.5, 1.0)
    start, target = np.array([0.0, 0.0, 0.0, 0.0]), np.array([1.0, 1.0, 0.0, 0.0])
    starts, targets = np.stack([start, target]), np.stack([target, 2 * target, start])
    solver = VerifiedSolver()
    ends = {"start": start, "target": target}
    limits = {"max_control": 0.5, "max_speed": 1.0, "speed_norm": 2, "tie_break_rise": 1e-7}
    norms = {"fuel_norm": 1, "control_norm": "inf", "objective": "fuel"}
    flown = transfer.solve(start, target)
    yield TransferProblem, {"model": steps, **limits, **norms}
    yield transfer.coast, {"start": start}
    yield transfer.is_too_fast, {"x": flown.x}
    yield transfer.slow_down, {"factor": 0.9}
    yield transfer.speed_excess, {"trajectory": flown}
    yield transfer.cost, {"trajectory": flown}
    yield transfer.solve_without_limits, {"start": start, "targets": targets}
    yield transfer.solve, {**ends, "solver": solver}
    yield transfer.simulate, {"start": start, "u": flown.u}
    yield transfer.build_cvxpy, {"start": start}
    yield Trajectory, {"x": flown.x, "u": flown.u, "fuel": flown.fuel}
    costs = compute_transfer_costs(transfer, starts, targets)
    yield TransferCosts, costs._asdict()
    many = {"start": starts, "targets": targets}
    yield compute_transfer_costs, {"transfer": transfer, **many, "solvers": [solver, solver]}
    yield auction_cost.compute_distances, {"steps": steps, **many}
    yield auction_cost.compute_energies, {"steps": steps, **many}
    yield solve_transfer, {"transfer": transfer, **ends, "solver": solver}
    few = {"displacement": starts, "max_control": 0.5, "weight": np.ones(6), "batches": 1}
    yield solve_minimum_fuel, {"steps": steps, **few}
    yield minimum_fuel.reachability_matrix, {"steps": steps}
    yield AvoidanceResult, {"trajectory": flown, "terminal_error": 0.0, "slack": 0.0}
    yield from _avoidance(transfer, AvoidanceProblem.alone(transfer, start, target), flown)


def _avoidance(transfer: Any, alone: Any, flown: Any) -> Iterator[Call]:
    from dynamics import DoubleIntegrator, discretize_zoh
    from problems import (
        AvoidanceHorizon,
        AvoidanceProblem,
        FixedSizeAvoidanceProblem,
        HalfSpaces,
        PairProblem,
        empty_half_spaces,
    )
    from problems.convexify import choose_normals, convexify
    from problems.pair_avoidance import RelativeHalfSpaces
    from problems.path_separation import are_hulls_separated

    steps, fine = transfer.model, discretize_zoh(DoubleIntegrator(2), 0.5, 12)
    horizon = AvoidanceHorizon(steps, fine, 0.3, (1.0, 0.5))
    both = {"discrete_model": steps, "fine_model": fine, "clearance": 0.3}
    points = horizon.control_points(flown.x, flown.u)
    others = points[None] + [3.0, 0.0]
    normal = choose_normals(points[None] - others, 0.3)
    rows = convexify(horizon, 6, others, normal)
    yield AvoidanceHorizon, {**both, "scale": (1.0, 0.5), "samples_only": False}
    yield horizon.with_clearance, {"clearance": 0.4}
    yield horizon.scale_points, {"points": points[0]}
    yield horizon.unscale_points, {"points": points[0]}
    yield horizon.control_points, {"x": flown.x, "u": flown.u}
    yield choose_normals, {"relative": points[None] - others, "separation": 0.3, "side": "same"}
    near = {"others": others, "normal": normal, "separation": 0.3}
    yield convexify, {"horizon": horizon, "T": 6, **near}
    yield are_hulls_separated, {"relative": points, "radius": 0.3, "is_exact": True}
    problem = AvoidanceProblem(transfer, flown.x[0], flown.x[-1], rows)
    ends = {"start": flown.x[0], "goal": flown.x[-1], "solver": alone.solver}
    more = {"half_spaces": rows, "tolerance": problem.tolerance}
    yield AvoidanceProblem, {"transfer": transfer, **ends, **more}
    yield AvoidanceProblem.alone, {"transfer": transfer, **ends}
    yield problem.select, {"rows": np.arange(3)}
    for method in ("solve", "generate", "solve_conic", "solve_cvxpy", "state_cvxpy"):
        yield getattr(problem, method), {"relaxation": "none"}
    yield problem.slow_down, {"factor": 0.9}
    yield problem.extract_trajectory, {"unknowns": np.zeros(24)}
    yield problem.assemble_conic, {"relaxation": "none", "limited": np.array([1])}
    yield HalfSpaces, rows._asdict()
    yield rows.violation, {"x": flown.x, "u": flown.u}
    yield rows.to_cvxpy, {"x": flown.x, "u": flown.u}
    free = {"transfer": transfer, "free": transfer.coast(flown.x[0])}
    yield rows.condense, free
    yield rows.condense_breakable, free
    yield rows.select, {"rows": np.arange(3)}
    yield rows.join, {"others": rows}
    excess = {"violation": rows.violation(flown.x, flown.u), "tolerance": 0.01}
    yield rows.find_peaks, excess
    yield rows.worst_per_step, excess
    yield empty_half_spaces, {"transfer": transfer}
    relative = RelativeHalfSpaces.from_normals(horizon, 6, normal[0])
    pair = PairProblem(problem, problem, relative)
    yield PairProblem, {"first": problem, "second": problem, "relative_half_spaces": relative}
    yield pair.violation, {"both": (flown, flown)}
    count = len(pair.violation((flown, flown)))
    yield pair.select, {"rows": np.ones(count, dtype=bool)}
    sizes = {"transfer": transfer, "rows_per_step": 2, "horizon_steps": 4}
    yield FixedSizeAvoidanceProblem, _fields(FixedSizeAvoidanceProblem, sizes)
    yield from _central(horizon, transfer, flown)


def _fields(kind: Any, values: dict[str, Any]) -> dict[str, Any]:
    return {name: values[name] for name in kind.__dataclass_fields__ if name in values}


def _central(horizon: Any, transfer: Any, flown: Any) -> Iterator[Call]:
    from dynamics import DoubleIntegrator
    from problems import CentralizedProblem, CentralizedResult, NonlinearProgram

    problem = CentralizedProblem.from_model(DoubleIntegrator(2), 1.0, 4, 0.3, 0.5, 1.0)
    own = {"own_transfers": (problem.transfer,) * 2, "clearances": np.array([0.3, 0.3])}
    both = {"transfer": problem.transfer, "horizon": problem.horizon}
    yield CentralizedProblem, {**both, **own}
    numbers = {"step": 1.0, "steps": 4, "collision_radius": 0.3, "max_control": 0.5}
    more = {"max_speed": 1.0, "objective": "fuel", "pieces": 2}
    yield CentralizedProblem.from_model, {"model": DoubleIntegrator(2), **numbers, **more}
    start = np.array([[0.0, 0.0, 0.0, 0.0], [2.0, 0.0, 0.0, 0.0]])
    ends = {"start": start, "goal": start + np.array([0.0, 1.0, 0.0, 0.0])}
    x, u = np.repeat(start[:, None], 5, axis=1), np.zeros((2, 4, 2))
    yield problem.solve, {**ends, "guesses": [(x, u)]}
    yield problem.nonlinear_program, {**ends, "guess": (x, u)}
    yield problem.simulate, {**ends, "u": u, "solver_message": "none"}
    program = problem.nonlinear_program(**ends)
    yield NonlinearProgram, _fields(NonlinearProgram, vars(program))
    yield program.trajectories, {"x": program.arguments["x0"]}
    solution = problem.simulate(**ends, u=u, solver_message="none")
    yield CentralizedResult, {"best": solution, "solutions": (solution,)}


def _programs() -> Iterator[Call]:
    from scipy.sparse import csc_array

    from problems import ConicProgram, ConicSolution, SolverAdapter, SolverResult, load_family
    from problems.conic import verify, verify_ray
    from problems.phase_one import relax_cones
    from problems.solvers import load_adapters
    from problems.solvers.adapter import lower_bounds
    from problems.solvers.verified import VerifiedSolver

    A = csc_array(np.array([[1.0, 1.0], [-1.0, 0.0], [0.0, -1.0]]))
    parts = {"q": np.array([1.0, 2.0]), "A": A, "b": np.array([1.0, 0.0, 0.0])}
    cones = {"zero": 1, "nonnegative": 2, "soc_sizes": (), "psd_orders": ()}
    program = ConicProgram(**parts, zero=1, nonnegative=2)
    found = VerifiedSolver()(program)
    point = {"problem": program, "x": found.x, "y": found.y}
    yield ConicProgram, {**parts, **cones, "P": csc_array(np.eye(2))}
    yield program.cost, {"x": found.x}
    yield program.differs_in_b_only, {"other": program}
    yield program.cone_violation, {"s": np.zeros(3), "dual": False}
    yield program.violation_cost, {"v": np.zeros(3)}
    yield program.move_into_dual_cone, {"y": found.y}
    yield ConicSolution, found._asdict()
    yield ConicSolution.evaluate, point
    answer = {"status": "solved", "message": "", "x": found.x, "y": found.y, "iterations": 3}
    yield SolverResult, answer
    yield verify, {"problem": program, "result": SolverResult(**answer), "tolerance": 1e-8}
    yield verify_ray, {"problem": program, "ray": np.array([1.0, -1.0, 0.0])}
    yield relax_cones, {"problem": program}
    adapter = load_adapters()["clarabel"]
    yield SolverAdapter, _fields(SolverAdapter, vars(adapter))
    yield adapter.refusal, {"problem": program}
    yield adapter.open_session, {"problem": program, "tolerance": 1e-8}
    yield adapter.require, {"problem": program}
    yield lower_bounds, {"b": np.ones(3), "zero": 1, "infinity": 1e20}
    solver = VerifiedSolver("highs", 1e-7)
    yield VerifiedSolver, {"name": "highs", "tolerance": 1e-7}
    yield solver.count_fallback, {"reason": "none"}
    yield solver.answer, {"problem": program}
    yield load_family, {"name": "transfer-lp", "size": "small"}


def _formations() -> Iterator[Call]:
    from problems import (
        DesiredFormation,
        GainMatrix,
        Pose,
        align,
        design_gains,
        is_globally_rigid,
        is_redundantly_rigid,
        is_rigid,
        solve_assignment,
    )
    from problems.gain_problem import GainProblem

    points = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 1.0], [2.0, 2.0, 1.0]])
    graph = ~np.eye(4, dtype=bool)
    formation = DesiredFormation(points, graph, "square")
    gains = design_gains(formation)
    gains.save("gains.npz")
    yield DesiredFormation, {"points": points, "graph": graph, "name": "square"}
    yield DesiredFormation.with_complete_graph, {"points": points, "name": "square"}
    yield GainMatrix, _fields(GainMatrix, vars(gains))
    yield gains.matches_formation, {"formation": formation}
    yield gains.save, {"path": "gains.npz"}
    yield GainMatrix.load, {"path": "gains.npz"}
    yield design_gains, {"formation": formation, "method": "auto", "tolerance": 0.1, "joint": True}
    problem = GainProblem.from_formation(formation, "xy")
    L = problem.complete_solution
    yield GainProblem, {"kernel": problem.kernel, "graph": graph}
    yield GainProblem.from_formation, {"formation": formation, "axes": "xy"}
    yield problem.project, {"W": L}
    yield problem.shift_kernel, {"L": L}
    yield problem.convergence_rate, {"L": L}
    yield problem.rate_bound, {"Y": np.zeros((4, 4))}
    pose = align(points, points + 1.0)
    yield Pose, {"yaw": pose.yaw, "translation": pose.translation}
    yield pose.transform, {"points": points}
    yield align, {"shape": points, "measured": points + 1.0, "mask": np.ones(4, dtype=bool)}
    rng = np.random.default_rng(1)
    rigid = {"graph": graph, "dimension": 2, "rng": rng}
    for function in (is_globally_rigid, is_redundantly_rigid, is_rigid):
        yield function, rigid
    yield solve_assignment, {"cost": np.array([[1.0, 2.0, 3.0], [2.0, 1.0, 5.0]])}
    yield from _graphs(points)


def _graphs(points: Any) -> Iterator[Call]:
    from problems import Camera, algebraic_connectivity
    from problems import interaction_graph as graphs

    camera, yaw = Camera(), np.zeros(4)
    seen = {"position": 2 * points, "yaw": yaw, "camera": camera}
    weight = graphs.interaction_graph(**seen).weights
    members = np.ones(4, dtype=bool)
    yield Camera, camera._asdict()
    yield graphs.cosine_ramp, {"x": np.array([0.5, 2.0]), "low": 0.0, "high": 1.0}
    yield graphs.range_weight, {"d": np.array([2.0, 4.0]), "camera": camera}
    yield graphs.interaction_graph, seen
    yield graphs.lambda2_gradient, seen
    yield graphs.laplacian, {"weight": weight}
    yield algebraic_connectivity, {"weight": weight, "members": members}
    yield graphs.spectral_slope, {"weight": weight, "slope": np.ones_like, "members": members}
