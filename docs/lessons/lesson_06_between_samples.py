# ---
# jupyter:
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Lesson 6: Why samples are not enough
#
# Problem 1 asks for a distance at *all* times [Morgan2016, eq. 4]. Its discretization asks for it
# at samples,
#
# $$\|G(\mathbf x_j[k] - \mathbf x_i[k])\|_2 \ge R_\text{col},\qquad k = k_0, \dots, T
#   \qquad\text{(eq. 13)},$$
#
# and so do eqs. 38 and 64. Vehicles move between samples. This lesson measures how near they come,
# finds the nearest instant exactly, and derives the constraint that holds in continuous time. The
# page on [safety](../safety.md) goes on from there to a proof for whole flights.

# %%
import os

import cvxpy as cp
import matplotlib.pyplot as plt
import numpy as np

import sato
from dynamics import ClohessyWiltshire, DoubleIntegrator, Orbit, discretize_zoh
from dynamics.trajectory_geometry import (
    control_points,
    divide_pieces,
    evaluate_bezier,
    hull_distance,
    interpolation_error,
    separations,
)
from problems import AvoidanceHorizon, AvoidanceProblem, TransferProblem
from problems.convexify import choose_normals, convexify
from problems.path_separation import are_hulls_separated

small = os.environ.get("SATO_LESSON_SIZE") == "small"  # fewer programs, for tests

# %% [markdown]
# ## Straight past each other
#
# Let the relative motion be straight with the speed $v$. The longest way between two samples at the
# distance $R$ is a chord of the disc of length $v\Delta t$. Its middle is nearest:
#
# $$d_\text{min} = \sqrt{R^2 - \left(\frac{v\Delta t}{2}\right)^2}
#   \quad\text{for } v\Delta t \le 2R,\qquad\text{and } 0 \text{ beyond}.$$
#
# In Sec. VI.B $R_\text{col} = 50$ m and $\Delta t = 60$ s. The paper does not print a speed limit.
# To be on a circle of 1 km radius about the chief takes 2.2 m/s, and two spacecraft that move
# against each other may have twice that.

# %%
R_orbit, minute = 50.0, 60.0
speed = np.linspace(0, 4.4, 200)
chord = np.maximum(R_orbit**2 - (speed * minute / 2) ** 2, 0)
figure, axes = plt.subplots(figsize=(6, 3.4), layout="constrained")
axes.plot(speed, np.sqrt(chord))
axes.axvspan(2 * R_orbit / minute, 4.4, color="C3", alpha=0.12)
axes.text(1.9, 25, "samples see nothing\nof a head-on collision", color="C3")
axes.set(xlabel="relative speed [m/s]", ylabel="least distance [m]", xlim=(0, 4.4))
axes.set_title("50 m kept at samples every 60 s")
plt.show()

# %% [markdown]
# ## A plan that keeps its distance at samples
#
# Take the crossing of Lesson 5, a flight of 20 s, and vary the step. `plan_by_samples` is Method 2
# with eq. 38 at samples. `plan_by_hulls` constrains control points instead, see below.

# %%
R, span, U = 1.0, 20.0, 0.15  # m, s, m/s²
starts = np.array([[-6.0, 0, 0, 0], [0.2, -6, 0, 0]])
goals = np.array([[6.0, 0, 0, 0], [0.2, 6, 0, 0]])


def prepare(dt):
    """Return the transfer problem for a step, and what both fly alone."""
    steps = discretize_zoh(DoubleIntegrator(2), dt, round(span / dt))
    transfer = TransferProblem(steps, U, tie_break_rise=1e-3)
    alone = [
        AvoidanceProblem.alone(transfer, start, goal).solve().trajectory
        for start, goal in zip(starts, goals, strict=True)
    ]
    return transfer, *alone


def plan_by_samples(dt, radius, iterations=6):
    """Plan the second vehicle around the first with half-planes at samples (eq. 38)."""
    transfer, first, nominal = prepare(dt)
    T = len(transfer.model)
    for _ in range(iterations):
        x, u, effort, limits = transfer.build_cvxpy(starts[1])
        limits.append(x[T] == goals[1])
        n = (nominal.x - first.x)[1:T, :2]
        along = cp.sum(cp.multiply(n, x[1:T, :2] - first.x[1:T, :2]), axis=1)
        limits.append(along >= radius * np.linalg.norm(n, axis=1))
        cp.Problem(cp.Minimize(effort), limits).solve(solver=cp.CLARABEL)
        nominal = transfer.simulate(starts[1], u.value)
    return first, nominal


def plan_by_hulls(dt, radius, iterations=6):
    """Plan it with one half-plane for all four control points of each piece."""
    transfer, first, nominal = prepare(dt)
    horizon = AvoidanceHorizon(transfer.model, transfer.model, radius)
    other = horizon.control_points(first.x, first.u)[None]
    for _ in range(iterations):
        relative = horizon.control_points(nominal.x, nominal.u)[None] - other
        normals = choose_normals(relative, horizon.required_separation)
        rows = convexify(horizon, len(transfer.model), other, normals)
        problem = AvoidanceProblem(transfer, starts[1], goals[1], rows)
        nominal = problem.solve().trajectory
    return first, nominal


def pieces_of(first, second, dt):
    """Return the Bézier points of the relative motion in each step [m]."""
    relative = second.x - first.x
    return control_points(relative[:, :2], relative[:, 2:], dt)


first, second = plan_by_samples(1.0, R)
pieces = pieces_of(first, second, 1.0)
fraction = np.linspace(0, 1, 50, endpoint=False)
curve = evaluate_bezier(np.repeat(pieces, 50, axis=0), np.tile(fraction, len(pieces)))
fine = np.linalg.norm(curve, axis=1)
at_samples = np.linalg.norm((second.x - first.x)[:, :2], axis=1)

figure, axes = plt.subplots(figsize=(6, 3.4), layout="constrained")
axes.plot(np.arange(len(fine)) / 50, fine, label="distance")
axes.plot(np.arange(21), at_samples, "o", color="C1", label="at samples")
axes.axhline(R, color="C3", lw=0.8)
axes.set(xlabel="time [s]", ylabel="distance [m]", xlim=(6, 14), ylim=(0, 4))
axes.legend()
plt.show()
print(f"at samples {at_samples.min():.4f} m, between them {fine.min():.4f} m")
assert at_samples.min() > R - 1e-6 > fine.min()

# %% [markdown]
# ## The nearest instant, exactly
#
# Under a zero-order hold a double integrator moves on a parabola in each step. Write it as a cubic
# Bézier curve, from positions $p_0, p_1$ and velocities $v_0, v_1$ at the ends of a step of length
# $h$:
#
# $$b_0 = p_0,\quad b_1 = p_0 + \tfrac h3v_0,\quad b_2 = p_1 - \tfrac h3v_1,\quad b_3 = p_1,\qquad
#   r(s) = \sum_{i=0}^3\binom3i(1-s)^{3-i}s^i\,b_i .$$
#
# Then $|r(s)|^2$ is a polynomial of degree six at most. Its minimum is at an end of the step or at
# a root of its derivative. No sampling is needed.


# %%
def nearest_by_roots(b):
    """Compute the least |r(s)| on [0, 1] by the roots of the derivative of |r|² [m]."""
    one = np.polynomial.Polynomial([1.0])
    s = np.polynomial.Polynomial([0.0, 1.0])
    basis = [(one - s) ** 3, 3 * (one - s) ** 2 * s, 3 * (one - s) * s**2, s**3]
    r = [sum(b[i, axis] * basis[i] for i in range(4)) for axis in range(b.shape[1])]
    square = sum(part**2 for part in r)
    roots = square.deriv().roots()
    inside = roots.real[(np.abs(roots.imag) < 1e-9) & (np.abs(roots.real - 0.5) <= 0.5)]
    return np.sqrt(np.clip(square(np.concatenate([[0, 1], inside])).min(), 0, None))


by_roots = min(nearest_by_roots(b) for b in pieces)
path = np.stack([first.x, second.x], axis=1)
alive = np.ones(path.shape[:2], dtype=bool)
exact = separations(path[..., :2], path[..., 2:], alive, 1.0).minimum
print(f"roots    {by_roots:.12f} m")
print(f"sato     {exact.distance:.12f} m at {exact.piece + exact.fraction:.4f} s")
print(f"50 samples a step  {fine.min():.12f} m")
assert np.isclose(by_roots, exact.distance, rtol=1e-10)
assert fine.min() >= exact.distance

# %% [markdown]
# ## A guarantee for the whole step
#
# $r(s)$ is a weighted mean of $b_0, \dots, b_3$: the weights are not negative and sum to one. So if
# *one* unit vector $n$ has
#
# $$n^Tb_i \ge R\quad\text{for } i = 0, 1, 2, 3,
#   \qquad\text{then}\qquad |r(s)| \ge n^Tr(s) \ge R\quad\text{for all } 0 \le s \le 1 .$$
#
# Four linear constraints a step in place of one, and nothing is lost but what the hull of the four
# points has more than the curve. How much is that? Divide each step into $k$ equal pieces:

# %%
parts = np.arange(1, 33)
bounds = [hull_distance(divide_pieces(pieces, k))[0].min() for k in parts.tolist()]
shortfall = exact.distance - np.array(bounds)
figure, axes = plt.subplots(figsize=(5, 3.4), layout="constrained")
axes.loglog(parts, shortfall, "o", ms=4)
axes.loglog(parts, shortfall[0] / parts**2, color="gray", lw=0.8)
axes.set(xlabel="pieces of a step, k", ylabel="distance less that of the hulls [m]")
plt.show()
assert (shortfall >= 0).all() and (shortfall <= 1.01 * shortfall[0] / parts**2).all()

# %% [markdown]
# The bound of the hulls is never above the truth, and falls short of it by at most $1/k^2$ of what
# it is for whole steps (gray). One to four pieces a step are enough in practice.
#
# Now plan with both, for several steps.

# %%
lengths = [1.0, 2.0] if small else [0.25, 0.5, 1.0, 2.0, 2.5]
least, fuel = {"samples": [], "hulls": []}, {"samples": [], "hulls": []}
for dt in lengths:
    for name, plan in (("samples", plan_by_samples), ("hulls", plan_by_hulls)):
        first, second = plan(dt, R)
        b = pieces_of(first, second, dt)
        least[name].append(min(map(nearest_by_roots, b)))
        fuel[name].append(second.fuel)
        if name == "hulls":
            assert are_hulls_separated(b, R).all()

figure, axes = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
for name, mark in (("samples", "o"), ("hulls", "^")):
    axes[0].plot(lengths, least[name], marker=mark, label=f"half-planes for {name}")
    axes[1].plot(lengths, fuel[name], marker=mark)
axes[0].axhline(R, color="C3", lw=0.8)
axes[0].set(xlabel="step Δt [s]", ylabel="least distance [m]", ylim=(0, 1.2))
axes[1].set(xlabel="step Δt [s]", ylabel="fuel of vehicle 2 [m/s]")
axes[0].legend(loc="lower left")
plt.show()
assert min(least["hulls"]) >= R > max(least["samples"])

# %% [markdown]
# Samples take less fuel because they keep less distance. With long steps the hulls of whole steps
# are dear; then each step is divided into pieces.
#
# ## When the motion is not a cubic
#
# In orbit the path between samples is not a polynomial. The cubic through both ends and both
# velocities is off by at most
#
# $$\max_t\left|\frac{d^4p}{dt^4}\right|\frac{h^4}{384} .$$
#
# Two vehicles may be nearer than their cubics by twice that. sato adds it to $R$.

# %%
orbit = Orbit.from_elements(6_878e3, inclination=np.radians(45))
cw = ClohessyWiltshire.from_orbit(orbit)
position = np.array([[800.0, 600.0, 300.0]])
state = np.hstack([position, cw.bounded_velocity(position)])


def cubic_error(h):
    """Return the proven bound and the measured error of cubics over 24 min of flight [m]."""
    count = round(24 * minute / h)
    steps = discretize_zoh(cw, h, count)
    u = np.zeros((1, count, 3))
    u[:, : count // 4] = 1e-3, 2e-3, 0
    x = steps.simulate(state, u)
    half = discretize_zoh(cw, h / 2, 1)
    middle = half.simulate(x[0, :-1], u[0][:, None])[:, 1, :3]
    b = control_points(x[0, :, :3], x[0, :, 3:], h)
    measured = np.linalg.norm(evaluate_bezier(b, 0.5) - middle, axis=1).max()
    return interpolation_error(cw, x, u, h), measured


for h in (240.0, 120.0, 60.0, 30.0):
    proven, measured = cubic_error(h)
    print(f"h = {h:4.0f} s: bound {proven:.2e} m, at the middle {measured:.2e} m")
    assert measured <= proven

# %% [markdown]
# At 60 s it is a third of a millimeter: in the linear model cubics are all one needs. Models that
# change with time have no such bound; there sato measures the error and doubles it.
#
# ## In a whole mission
#
# Every run records both distances, and `check` recomputes the exact one from the file.

# %%
run = sato.run("crossing", seed=0)
least_of_run = run.summary["min_separation_m"]
sampled = run.summary["min_separation_at_samples_m"]
print(f"crossing: {least_of_run:.6f} m, at samples {sampled:.6f} m, R = 1 m")
print(run.check())
assert sampled >= least_of_run >= 1.0

# %% [markdown]
# ## Exercises
#
# ### Exercise 1
#
# Derive the formula for $d_\text{min}$ and check it with 1,000 random straight motions whose
# samples all keep $R$: how near do they come?

# %% tags=["hide-cell"]
# Both samples are at R or farther, and the line passes the center at the distance d. On the line
# they are at √(R² − d²) or more from the foot point, on either side: vΔt ≥ 2√(R² − d²).
rng = np.random.default_rng(6)
count, step = 1000, 1.2  # vΔt, in units of R
miss, offset = rng.uniform(0, 1, count), rng.uniform(0, step, count)
ends = np.stack([offset - step, offset], axis=1)  # places of two samples along the line
keeps = (np.hypot(miss[:, None], ends) >= 1).all(axis=1)
nearest = miss[keeps].min()
print(f"{keeps.sum()} motions keep R at samples, the nearest at {nearest:.4f} R")
assert np.sqrt(1 - (step / 2) ** 2) <= nearest < 1

# %% [markdown]
# ### Exercise 2
#
# A simple cure: keep a larger radius $R' = \sqrt{R^2 + (v\Delta t/2)^2}$ at samples. Take the
# largest relative speed of the flight for $v$ and $\Delta t = 1$ s. Does it work, and what does it
# cost, compared with hulls?

# %% tags=["hide-cell"]
first, second = plan_by_samples(1.0, R)
v = np.linalg.norm((second.x - first.x)[:, 2:], axis=1).max()
wide = np.sqrt(R**2 + (v / 2) ** 2)
wider = plan_by_samples(1.0, wide)
near = min(map(nearest_by_roots, pieces_of(*wider, 1.0)))
hulls = plan_by_hulls(1.0, R)[1]
print(f"R' = {wide:.3f} m: least distance {near:.3f} m, fuel {wider[1].fuel:.3f} m/s")
print(f"hulls: fuel {hulls.fuel:.3f} m/s")
# It works, for about the fuel of the hulls. But v was taken from a plan that was already there, and
# with a bound for all vehicles, such as twice the speed limit, R' would be far larger. Hulls need
# neither a bound nor straight motion.
assert near >= R and abs(wider[1].fuel - hulls.fuel) < 0.05

# %% [markdown]
# ### Exercise 3
#
# Show that the error of the cubics falls with $h^4$. By how much must $R_\text{col} = 50$ m grow at
# $\Delta t = 240$ s?

# %% tags=["hide-cell"]
errors = np.array([cubic_error(h)[0] for h in (240.0, 120.0, 60.0, 30.0)])
ratios = errors[:-1] / errors[1:]
print("halving h divides the error by", np.round(ratios, 2))
assert (np.abs(ratios - 16) < 2).all()
print(f"2 × {errors[0]:.3f} m = {2 * errors[0]:.2f} m")
assert 2 * errors[0] < 0.5
