# ---
# jupyter:
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Lesson 5: Collisions as half-spaces, SCP step by step
#
# Two vehicles must stay apart,
#
# $$\|G(\mathbf x_j[k] - \mathbf x_i[k])\|_2 \ge R_\text{col}
#   \qquad\text{[Morgan2016, eq. 13]},$$
#
# with $G$ picking the position. The set of allowed positions is the *outside* of a disc, which is
# not convex: it has a hole. SATO replaces the outside by a half-plane that is inside of it (eq.
# 38), solves the convex program, and repeats about the solution. This is sequential convex
# programming, SCP (Method 2). In this lesson you draw the half-planes of every iteration. How the
# toolkit plans is on the page of the [method](../method.md#trajectories).

# %%
from itertools import pairwise

import cvxpy as cp
import matplotlib.pyplot as plt
import numpy as np

from dynamics import DoubleIntegrator, discretize_zoh
from dynamics.trajectory_geometry import evaluate_bezier
from problems import AvoidanceHorizon, AvoidanceProblem, TransferProblem
from problems.convexify import choose_normals, convexify

# %% [markdown]
# ## The half-plane
#
# Fix the other vehicle at its nominal position $\bar{\mathbf x}_i$, and let $\bar{\mathbf x}_j$ be
# our own. With the unit vector $n$ from the one to the other,
#
# $$n = \frac{G(\bar{\mathbf x}_j - \bar{\mathbf x}_i)}
#            {\|G(\bar{\mathbf x}_j - \bar{\mathbf x}_i)\|_2},\qquad
#   n^TG(\mathbf x_j - \bar{\mathbf x}_i) \ge R_\text{col}
#   \qquad\text{(eq. 38, divided by the norm)} .$$
#
# By Cauchy–Schwarz $\|G(\mathbf x_j - \bar{\mathbf x}_i)\| \ge n^TG(\mathbf x_j -
# \bar{\mathbf x}_i)$, so the half-plane lies outside the disc (Proposition 4). The other side of
# the disc is lost.

# %%
R = 1.0  # m
circle = R * np.exp(1j * np.linspace(0, 2 * np.pi, 100))


def draw_half_plane(axes, n, color="C3", reach=6.0, shade=True, lw=1.0):
    """Draw the boundary n·r = R, and shade what it forbids."""
    along = np.array([-n[1], n[0]])
    ends = np.array([R * n - reach * along, R * n + reach * along])
    axes.plot(*ends.T, color=color, lw=lw)
    if shade:
        corners = np.vstack([ends, ends[::-1] - 2 * reach * n])
        axes.fill(*corners.T, color=color, alpha=0.08)


figure, panels = plt.subplots(1, 2, figsize=(7.5, 3.6), sharey=True, layout="constrained")
own = np.array([0.9, 1.5])
for panel, title in zip(panels, ("eq. 13: not convex", "eq. 38: convex"), strict=True):
    panel.fill(circle.real, circle.imag, color="C3", alpha=0.25)
    panel.plot(0, 0, "ks", ms=4)
    panel.plot(*own, "o", color="C0")
    panel.annotate("other", (0, 0), xytext=(5, -12), textcoords="offset points")
    panel.annotate("own nominal", own, xytext=(6, 4), textcoords="offset points")
    panel.set(title=title, xlim=(-2, 3), ylim=(-2, 2.5), aspect="equal", xlabel="x [m]")
panels[0].set_ylabel("y [m]")
n = own / np.linalg.norm(own)
draw_half_plane(panels[1], n)
panels[1].annotate("", 1.6 * n, R * n, arrowprops={"arrowstyle": "->"})
panels[1].annotate("n", 1.6 * n, xytext=(-12, 0), textcoords="offset points")
plt.show()

# %% [markdown]
# ## Two vehicles cross
#
# Vehicle 1 flies from left to right, vehicle 2 from below to above, both in 20 s. Each first plans
# as if it were alone (Method 2, line 2). Vehicle 1 has priority and is done (Proposition 3).
# Vehicle 2 must keep away from it.
#
# The least fuel is often not unique (Lesson 2), and SCP could jump between equal optima for ever.
# `tie_break_rise` makes fuel dearer in the middle of the flight by a tenth of a percent. That
# selects burns at both ends.

# %%
dt, T, U = 1.0, 20, 0.15  # s, steps, m/s²
model = DoubleIntegrator(2)
steps = discretize_zoh(model, dt, T)
transfer = TransferProblem(steps, U, tie_break_rise=1e-3)
starts = np.array([[-6.0, 0, 0, 0], [0.2, -6, 0, 0]])
goals = np.array([[6.0, 0, 0, 0], [0.2, 6, 0, 0]])
first, alone = (
    AvoidanceProblem.alone(transfer, start, goal).solve().trajectory
    for start, goal in zip(starts, goals, strict=True)
)
# Pieces of the flight as cubics, which for a double integrator they are; Lesson 6 has more on them.
horizon = AvoidanceHorizon(steps, steps, R)


def relative_path(trajectory, parts=20):
    """Return the position relative to vehicle 1, many times a step [m]."""
    points = horizon.control_points(trajectory.x, trajectory.u)
    relative = points - horizon.control_points(first.x, first.u)
    fraction = np.linspace(0, 1, parts, endpoint=False)
    return evaluate_bezier(np.repeat(relative, parts, axis=0), np.tile(fraction, T))


closest = np.linalg.norm(relative_path(alone), axis=1).min()
print(f"alone: fuel {alone.fuel:.4f} m/s, closest {closest:.3f} m")
assert closest < R

# %% [markdown]
# ## SCP by hand
#
# One iteration is one linear program: Problem 6 and a half-plane for each sample (Problem 5). There
# is nothing to choose at $k = 0$ and $k = T$, where the state is given. Repeat until nothing
# changes by more than $\epsilon_\text{SCP}$ (eq. 39).


# %%
def solve_problem_5(nominal):
    """Solve Problem 5 about a nominal trajectory; return the trajectory and its normals."""
    x, u, effort, limits = transfer.build_cvxpy(starts[1])
    limits.append(x[T] == goals[1])
    between = nominal.x[1:T, :2] - first.x[1:T, :2]
    normals = between / np.linalg.norm(between, axis=1, keepdims=True)
    for k, n in enumerate(normals, 1):
        limits.append(n @ (x[k, :2] - first.x[k, :2]) >= R)
    program = cp.Problem(cp.Minimize(effort), limits)
    program.solve(solver=cp.CLARABEL)
    return transfer.simulate(starts[1], u.value), normals


iterates, all_normals = [alone], []
print(" w    fuel [m/s]   change [m]   least distance of samples [m]")
for w in range(1, 10):
    found, normals = solve_problem_5(iterates[-1])
    change = np.abs(found.x - iterates[-1].x).max()
    apart = np.linalg.norm(found.x[:, :2] - first.x[:, :2], axis=1).min()
    print(f"{w:2d} {found.fuel:12.5f} {change:12.5f} {apart:16.4f}")
    iterates.append(found)
    all_normals.append(normals)
    if change < 1e-4:
        break
fuels = [one.fuel for one in iterates[1:]]
assert change < 1e-4 and all(b <= a + 1e-5 for a, b in pairwise(fuels))

# %% [markdown]
# Now look at it as vehicle 1 sees it: at the origin, with vehicle 2 moving past. Each line is a
# half-plane as it was in the program, drawn for the steps in which vehicle 2 is near; the dots are
# the samples that it constrains.

# %%
figure, panels = plt.subplots(2, 2, figsize=(7.6, 7.8), sharey=True, layout="constrained")
for w, panel in enumerate(panels.flat):
    nominal, found, normals = iterates[w], iterates[w + 1], all_normals[w]
    panel.fill(circle.real, circle.imag, color="C3", alpha=0.25)
    panel.plot(*relative_path(nominal).T, "--", color="gray", lw=1, label="nominal")
    panel.plot(*relative_path(found).T, color="C0", label="solution")
    samples = (found.x - first.x)[1:T, :2]
    near = np.flatnonzero(np.linalg.norm(samples, axis=1) < 1.6)
    for count, k in enumerate(near):
        color = plt.cm.plasma(0.8 * count / max(1, len(near) - 1))
        draw_half_plane(panel, normals[k], color, shade=False)
        panel.plot(*samples[k], "o", color=color, ms=5, zorder=5)
    fuel = f"{found.fuel:.3f} m/s"
    panel.set(title=f"iteration {w + 1}: {fuel}", xlim=(-2.2, 2.2), ylim=(-2.2, 2.2))
    panel.set(aspect="equal", xlabel="x₂ − x₁ [m]")
for panel in panels[:, 0]:
    panel.set_ylabel("y₂ − y₁ [m]")
panels[0, 0].legend(loc="lower left")
plt.show()

# %% [markdown]
# In the first iteration the normals turn quickly, since the nominal passes close to the center. The
# solution keeps far from the disc. It is the next nominal: its half-planes touch the disc on the
# side on which it passes. Three facts make this work:
#
# - a nominal outside the disc satisfies its own half-planes, so there is always an answer
#   (Proposition 5);
# - the last solution stays feasible, so fuel never rises (Proposition 6, see the table);
# - a fixed point is a KKT point of the problem with discs (Theorem 7): a *local* optimum. SCP never
#   changes the side.
#
# Look closely at the last panel. The dots keep their distance, and the curve between them does not.
# That is the subject of Lesson 6.
#
# ## The same with sato
#
# sato constrains the path between samples too: each piece has four control points, whose convex
# hull contains it, and one normal for all four, the direction from the origin to the hull
# (`choose_normals`). `convexify` writes the rows, `AvoidanceProblem` solves.

# %%
other = horizon.control_points(first.x, first.u)[None]
nominal = alone
for w in range(1, 10):
    relative = horizon.control_points(nominal.x, nominal.u)[None] - other
    normals = choose_normals(relative, horizon.required_separation)
    half_spaces = convexify(horizon, T, other, normals)
    found = AvoidanceProblem(transfer, starts[1], goals[1], half_spaces).solve().trajectory
    change = np.abs(found.x - nominal.x).max()
    closest = np.linalg.norm(relative_path(found), axis=1).min()
    print(f"{w:2d} fuel {found.fuel:.5f} m/s, change {change:.5f} m, closest {closest:.4f} m")
    nominal = found
    if change < 1e-3:
        break
assert closest >= R
by_hulls = found

figure, axes = plt.subplots(figsize=(5, 4.4), layout="constrained")
axes.fill(circle.real, circle.imag, color="C3", alpha=0.25)
axes.plot(*relative_path(iterates[-1]).T, color="gray", lw=1, label="half-planes at samples")
axes.plot(*relative_path(by_hulls).T, color="C0", label="half-planes for hulls")
pieces = (horizon.control_points(by_hulls.x, by_hulls.u)[None] - other)[0]
axes.plot(*pieces[:, 0].T, "o", color="C0", ms=4)
for k in np.flatnonzero(np.linalg.norm(pieces, axis=2).min(axis=1) < 1.5):
    (points,) = axes.plot(*pieces[k].T, ".-", color="C1", lw=0.8, ms=4)
    draw_half_plane(axes, normals[0, k], "C1", shade=False, lw=0.6)
points.set_label("control points, and their half-planes")
axes.set(xlim=(-2.2, 2.2), ylim=(-2.2, 2.2), aspect="equal")
axes.set(xlabel="x₂ − x₁ [m]", ylabel="y₂ − y₁ [m]")
axes.legend(loc="lower left")
plt.show()
print(f"fuel of the guarantee: {100 * (by_hulls.fuel / iterates[-1].fuel - 1):.1f} %")

# %% [markdown]
# ## Exercises
#
# ### Exercise 1
#
# Check Proposition 4 with 10,000 random normals and points in the plane: no point of a half-plane
# is inside its disc. Which part of the allowed area does a half-plane give away, within a box of ±3
# m?

# %% tags=["hide-cell"]
rng = np.random.default_rng(5)
count = 10_000
angle = rng.uniform(0, 2 * np.pi, count)
normal = np.stack([np.cos(angle), np.sin(angle)], axis=1)
point = rng.uniform(-3, 3, (count, 2))
is_in_half_plane = (normal * point).sum(axis=1) >= R
is_outside_disc = np.linalg.norm(point, axis=1) >= R
assert is_outside_disc[is_in_half_plane].all()
# About 60 %: a half-plane is a poor picture of what is allowed, far from the nominal.
lost = 1 - is_in_half_plane.sum() / is_outside_disc.sum()
print(f"{100 * lost:.0f} % of the allowed area is given away")
assert 0.5 < lost < 0.7

# %% [markdown]
# ### Exercise 2
#
# SCP keeps the side on which it began. Is it the better one? Let `choose_normals` begin with
# `side="opposite"` and compare.

# %% tags=["hide-cell"]
results = {}
for side in ("same", "opposite"):
    nominal = alone
    for w in range(10):
        relative = horizon.control_points(nominal.x, nominal.u)[None] - other
        begin = side if w == 0 else "same"
        normals = choose_normals(relative, horizon.required_separation, begin)
        half_spaces = convexify(horizon, T, other, normals)
        nominal = AvoidanceProblem(transfer, starts[1], goals[1], half_spaces).solve().trajectory
    results[side] = nominal.fuel
    print(f"{side:9} {nominal.fuel:.4f} m/s")
# Two local optima. The nominal passes at 0.14 m on one side, which is the cheaper one here. The
# program tries both, and takes the one with less fuel.
assert results["same"] < results["opposite"]

# %% [markdown]
# ### Exercise 3
#
# Why priorities (Theorem 8)? Let *both* vehicles keep $R$ from the other's last trajectory, at
# once. Compare the fuel of both with that of the solution above.

# %% tags=["hide-cell"]
# Each makes room for the other where it was. After that both have moved aside, so each may come
# back, at once. It does not settle, and every second iterate collides. With priority one
# trajectory stays fixed, which is what Theorem 7 needs.
both, closest = [first, alone], []
for w in range(10):
    points = [horizon.control_points(one.x, one.u)[None] for one in both]
    found = []
    for own in (0, 1):
        relative = points[own] - points[1 - own]
        normals = choose_normals(relative, horizon.required_separation)
        half_spaces = convexify(horizon, T, points[1 - own], normals)
        problem = AvoidanceProblem(transfer, starts[own], goals[own], half_spaces)
        found.append(problem.solve().trajectory)
    change = max(np.abs(a.x - b.x).max() for a, b in zip(both, found, strict=True))
    both = found
    apart = np.linalg.norm((both[0].x - both[1].x)[:, :2], axis=1).min()
    closest.append(apart)
    fuel = sum(one.fuel for one in both)
    print(f"iteration {w + 1:2}: {fuel:.3f} m/s, closest {apart:.2f} m, change {change:.2f} m")
print(f"with priority: {first.fuel + by_hulls.fuel:.3f} m/s")
assert change > 0.1 and min(closest[-2:]) < R
