# ---
# jupyter:
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Lesson 9: Gains, the semidefinite program, the paper's ADMM, the certificate
#
# A formation of $n$ vehicles is held by one matrix of gains. This lesson derives its kernel, poses
# the design as a semidefinite program [Lusk2020, eqs. 5 and 7], runs the iteration that the paper
# solves it with (eq. 10), and ends with a bound that proves how far any gains are from the optimum.
#
# You need: eigenvalues of Hermitian matrices, and the idea of a dual variable. The methods of the
# toolkit are on the page of [formation flight](../formation.md#gains).

# %%
import os
import textwrap

import matplotlib.pyplot as plt
import numpy as np
from scipy.linalg import expm

from problems import gain_paper, gain_sdp
from problems.gain_design import NoStabilizingGain, design_gains
from problems.gain_problem import GainProblem
from problems.rigidity import is_rigid
from sato.shapes.formation_library import (
    graph_from_edges,
    load_formation,
    make_formation,
    random_sparse_graph,
)

small = os.environ.get("SATO_LESSON_SIZE") == "small"  # shorter runs, for tests

# %% [markdown]
# ## The control law and its kernel
#
# Vehicle $i$ flies with the weighted sum of what it measures of its neighbors [Lusk2020, eq. 2],
#
# $$\dot q_i = \sum_{j \in \mathcal N_i} A_{ij}\,(q_j - q_i), \qquad
# A_{ij} = \begin{bmatrix} a & -b & 0 \\ b & a & 0 \\ 0 & 0 & c \end{bmatrix}.$$
#
# $A_{ij}$ commutes with every rotation about the vertical. So vehicle $i$ may apply it in its own
# axes, whatever its heading: no common frame is needed. The horizontal block is a complex number
# $a + \mathrm j b$. With $q_i = x_i + \mathrm j y_i$ the swarm moves as $\dot q = A q$, $A$ complex
# and $n \times n$ (eq. 3 in complex form), and the heights move as $\dot z = B z$, $B$ real.
#
# The desired points $p$ must be at rest, and so must every copy of them that is moved, turned or
# scaled. In complex numbers these are $\alpha p + \beta 1$, so (4) becomes
#
# $$A K = 0, \qquad K = \text{an orthonormal basis of } \operatorname{span}\{p, 1\}.$$
#
# All other eigenvalues of $A$ must be negative.

# %%
pyramid = load_formation("Pentagonal Pyramid")
p, n = pyramid.planar_points, len(pyramid.points)
K, _ = np.linalg.qr(np.stack([p, np.ones(n)], axis=1))
print(f"{n} points, {pyramid.edge_count} of {n * (n - 1) // 2} edges")


def draw_formation(ax, formation):
    """Draw a formation as seen from above."""
    points = formation.points
    for i, j in np.argwhere(np.triu(formation.graph)):
        ax.plot(*points[[i, j], :2].T, color="0.6", lw=1)
    ax.scatter(*points[:, :2].T, c=points[:, 2], cmap="viridis", zorder=2)
    for i, point in enumerate(points):
        ax.annotate(str(i), point[:2], xytext=(5, 4), textcoords="offset points")
    ax.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    ax.margins(0.12)


fig, ax = plt.subplots(figsize=(3.6, 3.4), layout="constrained")
draw_formation(ax, pyramid)
ax.set_title("Pentagonal pyramid, from above")
plt.show()

# %% [markdown]
# On the **complete graph** no program is needed. Fix the mean eigenvalue of $-A$ outside the kernel
# to 1, for otherwise $sA$ with a larger $s$ is always faster. The slowest is then at most the mean,
# and
#
# $$L = -A = I - K K^{\mathsf H}$$
#
# has all of them at 1. Nothing is faster.

# %%
L = np.eye(n) - K @ K.conj().T
complete = design_gains(load_formation("Pentagonal Pyramid", graph="complete"))
print("by hand, eigenvalues of L:", np.round(np.linalg.eigvalsh(L), 12))
assert np.allclose(complete.xy, -L)
assert np.allclose(L @ p, 0)
assert np.allclose(L.sum(axis=1), 0)

# %% [markdown]
# ## The semidefinite program
#
# With an incomplete graph, $L_{ij} = 0$ where $i$ does not measure $j$. The design problem
# [Lusk2020, eqs. 5 and 7], horizontally or vertically, is
#
# $$\begin{aligned}
# \text{maximize}\quad & t \\
# \text{subject to}\quad & L \succeq t\,(I - K K^{\mathsf H}),\quad L K = 0, \\
# & \operatorname{tr} L = m,\qquad L_{ij} = 0 \ \text{at non-edges},
# \end{aligned}$$
#
# with $m = n - \operatorname{rank} K$ the number of eigenvalues outside the kernel. $t$ is the
# *rate*: the slowest error decays as $e^{-t\tau}$ with time $\tau$. `problems.gain_sdp` hands this
# program to an interior-point solver.

# %%
problem = GainProblem.from_formation(pyramid, "xy")
optimum = gain_sdp.solve(problem)
rate = problem.convergence_rate(optimum.L)
bound = problem.rate_bound(optimum.Y)
print(f"rate {rate:.7f}, proven bound {bound:.7f}")

nearest = problem.project(np.eye(n))  # nearest to the ideal among those that the graph allows
fig, ax = plt.subplots(figsize=(5.2, 3.2), layout="constrained")
for name, matrix, mark in (
    ("complete graph", L, "o"),
    ("projection of it on the 8 edges", nearest.L, "v"),
    ("optimum on the 8 edges", optimum.L, "s"),
):
    ax.plot(np.arange(1, n + 1), np.linalg.eigvalsh(matrix), mark, label=name, alpha=0.8)
ax.axhline(rate, color="0.6", lw=1, ls="--")
ax.set(xlabel="number of the eigenvalue", ylabel="eigenvalue of −A [1/s]")
ax.set_title("Two eigenvalues are 0: the kernel")
ax.legend()
plt.show()

# %% [markdown]
# The optimum raises the least eigenvalue of the projection by a fifth. The others are free: they
# share what is left of the trace.
#
# ## The paper's ADMM
#
# The paper writes the program as $\min \langle C, X\rangle$ subject to $\mathcal A(X) = b$,
# $X \succeq 0$, with $X = \begin{bmatrix}\gamma I & I \\ I & Z\end{bmatrix}$ (eq. 8), where
# $L = Q Z Q^{\mathsf H}$ and $Q$ is a basis of the complement of $K$. $X \succeq 0$ means
# $Z \succeq I/\gamma$, so a small $\gamma$ is a large rate. With the dual variables $y$ and
# $S$, a penalty $\mu > 0$, and $\mathcal P_{\mathrm{psd}}$ the projection onto the positive
# semidefinite matrices, one iteration is (eq. 10)
#
# $$\begin{aligned}
# y &\leftarrow (\mathcal A \mathcal A^*)^{-1}\bigl(\mathcal A(C - S - \mu X) + \mu b\bigr), &
# W &\leftarrow C - \mathcal A^*(y) - \mu X, \\
# S &\leftarrow \mathcal P_{\mathrm{psd}}(W), & X &\leftarrow (S - W)/\mu .
# \end{aligned}$$
#
# The authors' code stops when the trace is within 10 % of $m$, after at most 10 iterations, and
# then projects $Z$ onto the equations. Below, the same iteration with other limits.

# %%
rng = np.random.default_rng(0)
points = rng.uniform(0, 5, (10, 3))
sparse = make_formation(points, random_sparse_graph(points, 0.5, rng), "random, half of the edges")
cases = {"pyramid, 8 of 15 edges": pyramid, "random, 22 of 45 edges": sparse}
counts = np.unique(np.geomspace(1, 300 if small else 3000, 10 if small else 25).astype(int))

fig, axes = plt.subplots(1, 2, figsize=(8.4, 3.4), layout="constrained")
printed_rates = {}
for ax, (name, formation) in zip(axes, cases.items(), strict=True):
    each = GainProblem.from_formation(formation, "xy")
    solutions = [gain_paper.solve(each, int(k), 0.0, 0.0) for k in counts]
    ax.semilogx(counts, [each.convergence_rate(s.L) for s in solutions], label="rate")
    ax.semilogx(counts, [each.rate_bound(s.Y) for s in solutions], label="bound from y")
    best = each.convergence_rate(gain_sdp.solve(each).L)
    ax.axhline(best, color="0.5", lw=1, ls="--", label="interior point")
    printed = gain_paper.solve(each)  # with the stopping rule of the paper's code
    printed_rates[name] = each.convergence_rate(printed.L), best
    ax.axhline(printed_rates[name][0], color="C3", lw=1, ls=":", label="stopped as in the code")
    ax.axhline(0, color="k", lw=0.5)
    ax.set(xlabel="iterations of (10)", ylabel="rate [1/s]", title=name)
axes[0].legend(fontsize="small")
plt.show()
for name, (stopped, best) in printed_rates.items():
    print(f"{name}: stopped as in the code {stopped:+.4f}, optimum {best:.4f}")

# %% [markdown]
# The iteration is right; the stopping rule is not. On the pyramid it gives 10 % less than the
# optimum. On the sparse graph the rate is **negative**: these gains push the swarm out of its
# shape, though stable gains exist. Nothing in the iterate says so. Hence the next section.

# %%
stopped, best = printed_rates["random, 22 of 45 edges"]
assert stopped < 0 < best

# %% [markdown]
# ## The certificate
#
# Take *any* Hermitian $Y \ne 0$ with entries at non-edges only. Let $Q$ span the complement of $K$,
# $W = Q^{\mathsf H} Y Q$, $\ell$ the least eigenvalue of $W$ and $\bar\mu$ the mean of all. Every
# $L = Q Z Q^{\mathsf H}$ that the graph allows is zero where $Y$ is not, so
#
# $$0 = \langle Y, L\rangle = \langle W, Z\rangle .$$
#
# $S = W - \ell I \succeq 0$ then has $\langle S, Z\rangle = -\ell \operatorname{tr} Z = -\ell m$.
# From $Z \succeq t I$ follows $t \operatorname{tr} S \le \langle S, Z\rangle$, and
# $\operatorname{tr} S = (\bar\mu - \ell) m$:
#
# $$\boxed{\;t \le \frac{-\ell}{\bar\mu - \ell}\;}$$
#
# The bound holds for every $Y$, wherever it comes from. A good $Y$ makes it tight: the dual
# variables of a solver. Checking it takes one eigenvalue decomposition, and no trust.

# %%
Q = problem.complement


def bound_by_hand(Y):
    """Evaluate the boxed formula."""
    values = np.linalg.eigvalsh(Q.conj().T @ Y @ Q)
    return -values[0] / (values.mean() - values[0])


print(f"by hand {bound_by_hand(optimum.Y):.7f}, product {bound:.7f}, rate {rate:.7f}")
assert np.isclose(bound_by_hand(optimum.Y), bound)
assert 0 <= bound - rate < 1e-5

# A guess is also a certificate, only a worse one.
guess = np.where(pyramid.graph | np.eye(n, dtype=bool), 0, -1.0)
print(f"Y = −1 at all non-edges proves: no rate above {bound_by_hand(guess):.3f}")
assert bound_by_hand(guess) >= rate

# %% [markdown]
# A bound of zero or less proves that **no** gains stabilize the formation on its graph. The toolkit
# then refuses, with the proof, and names the edge to add first. A square can be held by its four
# sides. Move one corner, and it cannot.

# %%
sides = graph_from_edges(4, [[0, 1], [1, 2], [2, 3], [3, 0]])
square = np.array([[1.0, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]])
print(f"square: rate {design_gains(make_formation(square, sides)).convergence_rate:.3f}")
refusal = None
try:
    design_gains(make_formation(square + np.eye(4, 3, -3), sides))
except NoStabilizingGain as none:
    refusal = none
assert refusal is not None
assert refusal.bound <= 1e-6
print(*textwrap.wrap(str(refusal), 80), sep="\n")

# %% [markdown]
# ## Flown
#
# Without limits and avoidance the flight is $q(\tau) = e^{A\tau} q(0)$. The distance to the set of
# desired shapes, $\lVert q - K K^{\mathsf H} q\rVert$, falls at least as fast as $e^{-t\tau}$. The
# unstable gains of the paper's stopping rule leave it.

# %%
each = GainProblem.from_formation(sparse, "xy")
fast = -each.project(design_gains(sparse).xy * -1).L
loose = -gain_paper.solve(each).L
q0 = rng.normal(size=10) * 3 + 1j * rng.normal(size=10) * 3
times = np.linspace(0, 120, 121)
kernel = sparse.kernel_xy

fig, ax = plt.subplots(figsize=(5.2, 3.2), layout="constrained")
for A, label in ((fast, "design_gains"), (loose, "(10), stopped as in the code")):
    step, q, errors = expm(A * times[1]), q0, []
    for _ in times:
        errors.append(np.linalg.norm(q - kernel @ (kernel.conj().T @ q)))
        q = step @ q
    ax.semilogy(times, errors, label=label)
    if label == "design_gains":
        decay = each.convergence_rate(-A)
        assert np.all(np.array(errors) <= errors[0] * np.exp(-decay * times) * (1 + 1e-9))
        ax.semilogy(
            times, errors[0] * np.exp(-decay * times), "k--", lw=0.8, label="exp(−rate · t)"
        )
ax.set(xlabel="time [s]", ylabel="distance from the shape [m]")
ax.legend()
ax.grid(alpha=0.3)
plt.show()

# %% [markdown]
# ## Exercises
#
# ### Exercise 1
#
# One edge more: which of the seven non-edges of the pyramid raises the rate most when it is added?
# Is it the entry of the dual $Y$ that is largest?

# %% tags=["hide-cell"]
# Try all seven.
i, j = problem.non_edges
gain = {}
for a, b in zip(i, j, strict=True):
    graph = pyramid.graph.copy()
    graph[a, b] = graph[b, a] = True
    gain[int(a), int(b)] = design_gains(make_formation(pyramid.points, graph)).rate_xy
    print(f"{a}–{b}: rate {gain[a, b]:.4f}, |Y| = {abs(optimum.Y[a, b]):.3f}")
winner = max(gain, key=gain.get)
largest = max(gain, key=lambda edge: abs(optimum.Y[edge]))
print(f"the best edge is {winner}, the largest dual is at {largest}")
assert all(value >= rate * (1 - 1e-3) for value in gain.values())  # an edge more never hurts
print("The dual is a derivative: it ranks small changes, not whole edges.")

# %% [markdown]
# ### Exercise 2
#
# The paper assumes a universally rigid graph. Show that the pyramid's graph is not even rigid in
# the plane, and that its gains are stable all the same. How can both be true?

# %% tags=["hide-cell"]
# In the plane n points need 2 n − 3 edges; the pyramid has one less.
assert pyramid.edge_count < 2 * n - 3
assert not is_rigid(pyramid.graph, 2, rng)
assert design_gains(pyramid).rate_xy > 0.29
# Rigidity is about lengths alone: an edge gives one equation. Gains use directions too: a
# complex weight on the vector q_j − q_i, one complex equation a vehicle. They leave the size free.

# %% [markdown]
# ### Exercise 3
#
# Problem (5) fixes the trace of the whole matrix, not of each direction. With rates $t_{xy}$, $t_z$
# for equal means, and $2 m_{xy}$ and $m_z$ eigenvalues, which common rate can both reach? Compare
# with `design_gains(..., joint=True)`.

# %% tags=["hide-cell"]
# Scaling a direction scales its rate and its trace alike. With shares v of the trace,
# rates are t v / w; they are equal, and the shares sum to w_xy + w_z, at the harmonic mean.
gains = design_gains(pyramid)
w_xy, w_z = 2 * problem.m, GainProblem.from_formation(pyramid, "z").m
common = (w_xy + w_z) / (w_xy / gains.rate_xy + w_z / gains.rate_z)
joint = design_gains(pyramid, joint=True)
print(f"separately {gains.rate_xy:.4f} and {gains.rate_z:.4f}, jointly {common:.4f}")
assert np.isclose(joint.rate_xy, common)
assert np.isclose(joint.rate_z, common)
