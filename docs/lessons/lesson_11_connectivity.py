# ---
# jupyter:
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Lesson 11: λ₂ under a field of view
#
# Robots with cameras must stay connected while an operator leads one of them away [Bernard2023].
# One number tells whether they are connected: $\lambda_2$, the second eigenvalue of a weighted
# Laplacian. This lesson builds the weights, differentiates $\lambda_2$, meets the states where that
# derivative does not exist, and shows how the printed controller chatters there and a smooth
# potential does not.

# %%
import os
from functools import partial

import matplotlib.pyplot as plt
import numpy as np

import sato
from dynamics.vehicle import rotate_by_yaw
from problems.interaction_graph import (
    Camera,
    algebraic_connectivity,
    cosine_ramp,
    interaction_graph,
    lambda2_gradient,
    laplacian,
    range_weight,
    spectral_slope,
)
from sato.connectivity.controller import evaluate_potential, negative_slope
from sato.connectivity.settings import Potential

small = os.environ.get("SATO_LESSON_SIZE") == "small"  # shorter runs, for tests
camera, potential = Camera(), Potential()  # [Bernard2023, Table I]

# %% [markdown]
# ## Weights
#
# Robot $i$ at $p_i$ with yaw $\psi_i$ sees robot $j$ at the bearing $\beta_{ij} = R_i^T (p_j - p_i)
# / d_{ij}$. With $o_C$ the optical axis, $a_{ij} = o_C^T \beta_{ij}$ is the cosine of the angle off
# the axis. Two ramps of half a cosine, $w_1^0$ rising and $w_0^1$ falling (eqs. 7 and 8), give
#
# $$\begin{aligned}
# \gamma_{ij} &= w_1^0(d_{ij}; d_{\min}, D_1)\, w_0^1(d_{ij}; D_2, d_{\max}) && \text{(9)}\\
# f^*_{ij} &= w_1^0(a_{ij}; a_{\min}, a_{\max}) && \text{(10)}\\
# f_{ij} &= f^*_{ij} + f^*_{ji} - f^*_{ij} f^*_{ji} && \text{(11)}\\
# A_{ij} &= \gamma_{ij} f_{ij} && \text{(6)}
# \end{aligned}$$
#
# (11) is symmetric, and it is enough that one of the two sees the other.

# %%
d, angle = np.linspace(0, 10, 201), np.linspace(0, 120, 201)
fig, axes = plt.subplots(1, 3, figsize=(9.6, 3.0), layout="constrained")
axes[0].plot(d, range_weight(d, camera))
axes[0].set(xlabel="distance [m]", ylabel="γ", title="Range, eq. 9")
axes[1].plot(angle, cosine_ramp(np.cos(np.radians(angle)), camera.a_min, camera.a_max))
axes[1].set(xlabel="angle off the axis [°]", ylabel="f*", title="Field of view, eq. 10")

# One robot at the origin; another anywhere, which looks away from it.
x, y = np.meshgrid(np.linspace(-10, 10, 101), np.linspace(-10, 10, 101))
other = np.stack([x, y, 0 * x], axis=-1)
position = np.stack([np.zeros_like(other), other], axis=-2)
yaw = np.stack([0 * x, np.arctan2(y, x) - np.pi / 4], axis=-1)
weight = interaction_graph(position, yaw, camera).weights[..., 0, 1]
shown = axes[2].pcolormesh(x, y, weight, cmap="YlGnBu", shading="nearest")
axes[2].annotate("", np.multiply(2.5, camera.optical_axis[:2]), (0, 0), arrowprops={"color": "C3"})
axes[2].set(xlabel="x [m]", ylabel="y [m]", aspect="equal", title="A of a robot at the origin")
fig.colorbar(shown, ax=axes[2])
plt.show()

# %% [markdown]
# ## λ₂ and the Fiedler vector
#
# $L = \operatorname{diag}(\sum_j A_{ij}) - A$ is symmetric with $L 1 = 0$. Its quadratic form is
#
# $$v^T L v = \sum_{i<j} A_{ij} (v_i - v_j)^2 ,$$
#
# so all eigenvalues are at least 0, and $\lambda_2 > 0$ if and only if the graph is connected. The
# unit eigenvector $v_2$, the *Fiedler vector*, minimizes $v^T L v$ among unit vectors orthogonal to
# 1, the vector of ones: it changes most across the weakest cut. For a simple $\lambda_2$,
#
# $$\lambda_2 = v_2^T L v_2, \qquad
# \frac{\partial \lambda_2}{\partial A_{ij}} = (v_{2i} - v_{2j})^2 .$$

# %%
rng = np.random.default_rng(3)
n = 6
position = np.array([[0, 0, 0], [3, 1.5, 0], [1, 4, 0], [9.5, 3, 0], [12, 0.5, 0], [13, 4.5, 0.0]])
toward = position.mean(axis=0) - position
yaw = np.arctan2(toward[:, 1], toward[:, 0]) - np.pi / 4  # the axis looks at the middle


def draw_graph(ax, position, weight, vector):
    """Draw robots from above, colored by the Fiedler vector, and edges as wide as their weights."""
    for i, j in np.argwhere(np.triu(weight) > 0):
        ax.plot(*position[[i, j], :2].T, color="0.6", lw=4 * weight[i, j], zorder=1)
    most = np.abs(vector).max()
    marks = ax.scatter(*position[:, :2].T, c=vector, cmap="coolwarm", vmin=-most, vmax=most, s=90)
    for i, place in enumerate(position):
        ax.annotate(str(i), place[:2], ha="center", va="center", fontsize=8)
    ax.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    ax.margins(0.15)
    return marks


weight = interaction_graph(position, yaw, camera).weights
values, vectors = np.linalg.eigh(laplacian(weight))
found = algebraic_connectivity(weight)
by_hand = (vectors[:, 1, None] - vectors[:, 1]) ** 2
print("eigenvalues", values.round(3))
assert np.isclose(found.lambda2, values[1])
assert np.allclose(found.weight_gradient, by_hand)

fig, ax = plt.subplots(figsize=(6, 3.2), layout="constrained")
marks = draw_graph(ax, position, weight, vectors[:, 1])
fig.colorbar(marks, ax=ax, label="Fiedler vector", shrink=0.8)
gradient = lambda2_gradient(position, yaw, camera)
ax.quiver(*position[:, :2].T, *gradient.position[:, :2].T, angles="xy", width=0.005, zorder=3)
ax.set_title(f"λ₂ = {values[1]:.2f}; arrows: ∂λ₂/∂p")
plt.show()

# %% [markdown]
# Edges at full weight cannot grow. Of the thin ones, 2–3 crosses the cut, where $v_2$ changes
# most: closing it raises $\lambda_2$ most.
#
# ## The gradient
#
# By the chain rule, for $x_i$ the position or the yaw of robot $i$,
#
# $$\frac{\partial\lambda_2}{\partial x_i}
#   = \sum_j (v_{2i}-v_{2j})^2\,\frac{\partial A_{ij}}{\partial x_i}$$
#
# with (12) and (13) for $\partial A_{ij}$. Formulas of that length deserve a test: central
# differences.


# %%
def lambda2_of(position, yaw):
    """Compute λ₂ of a state."""
    return np.linalg.eigvalsh(laplacian(interaction_graph(position, yaw, camera).weights))[1]


h, worst = 1e-6, 0.0
for _ in range(10 if small else 100):
    p, psi = rng.uniform(-4, 4, (n, 3)), rng.uniform(-np.pi, np.pi, n)
    gradient = lambda2_gradient(p, psi, camera)
    dp, dpsi = rng.normal(size=(n, 3)), rng.normal(size=n)
    rise = lambda2_of(p + h * dp, psi + h * dpsi) - lambda2_of(p - h * dp, psi - h * dpsi)
    predicted = np.sum(gradient.position * dp) + gradient.yaw @ dpsi
    worst = max(worst, abs(rise / (2 * h) - predicted))
print(f"largest error of a directional derivative: {worst:.1e}")
assert worst < 1e-6

# %% [markdown]
# As printed, Sec. III-C computes $\beta_{ji} = -{}^iR_j\,\beta_{ij}$. The rotation must be
# transposed, $\beta_{ji} = -({}^iR_j)^T \beta_{ij}$; the test above finds such errors at once. The
# page of [connectivity](../connectivity.md#errors-of-the-paper) lists all of them.
#
# ## The potential
#
# The controller descends $V(\lambda_2)$, with $x = \lambda_2 - \lambda_2^{\min}$ and
# $m = \lambda_2^{\max} - \lambda_2^{\min}$:
#
# $$V = k\,\frac{(m - x)^2}{x} \quad (0 \text{ for } x \ge m), \qquad
# \dot x_i = -V'(\lambda_2)\,\frac{\partial\lambda_2}{\partial x_i} \qquad\text{(3), (5)}$$
#
# The paper draws $V$ (Fig. 2) and gives no formula; this one has the same ends. It is infinite at
# $\lambda_2^{\min}$, and descent cannot raise $V$, so the team stays connected. But (3) needs a
# gradient, and there is one only where $\lambda_2 < \lambda_3$.
#
# ## Where eigenvalues meet
#
# Put six robots on a ring, each looking at the next. The weights are those of a cycle, and by
# symmetry $\lambda_2 = \lambda_3$. Stretch the ring by $1 + s$ along $x$ and by $1/(1 + s)$ along
# $y$.

# %%
theta = 2 * np.pi * np.arange(n) / n


def ring(s, radius=7.5):
    """Return positions and yaws of a ring, stretched by 1 + s along x."""
    position = radius * np.stack([np.cos(theta) * (1 + s), np.sin(theta) / (1 + s), 0 * theta], 1)
    return position, theta + 4 * np.pi / 3 - np.pi / 4  # the axis along a side


def spectrum(position, yaw):
    """Compute all eigenvalues of a state."""
    return np.linalg.eigvalsh(laplacian(interaction_graph(position, yaw, camera).weights))


stretches = np.linspace(-0.05, 0.05, 201)
values = np.array([spectrum(*ring(s)) for s in stretches])
alone = evaluate_potential(values[:, 1], potential)
whole = evaluate_potential(values[:, 1:], potential).sum(axis=1)
fig, axes = plt.subplots(1, 3, figsize=(10, 3.0), layout="constrained")
axes[0].plot(stretches, values[:, 1:3], label=["λ₂", "λ₃"])
axes[0].set(xlabel="stretch s", ylabel="eigenvalue", title="They meet at s = 0")
axes[0].legend()
axes[1].plot(stretches, alone - alone.min(), label="V(λ₂)")
axes[1].plot(stretches, whole - whole.min(), label="Σ V(λₖ)")
axes[1].set(xlabel="stretch s", ylabel="potential, less its minimum", title="Potential")
axes[1].legend()
step = stretches[1] - stretches[0]
axes[2].plot(stretches[1:], np.diff(alone) / step, label="V(λ₂)")
axes[2].plot(stretches[1:], np.diff(whole) / step, label="Σ V(λₖ)")
axes[2].set(xlabel="stretch s", ylabel="dV/ds", title="Slope")
axes[2].legend()
plt.show()

middle = len(stretches) // 2
slopes = {name: np.diff(V)[[middle - 1, middle]] / step for name, V in
          (("alone", alone), ("whole", whole))}  # fmt: skip
print({name: slope.round(3) for name, slope in slopes.items()})
assert np.isclose(values[middle, 1], values[middle, 2])
assert np.ptp(slopes["alone"]) > 20 * np.ptp(slopes["whole"])

# %% [markdown]
# $\lambda_2(s) = \min$ of two smooth branches has a kink at its **maximum**: that is where a
# controller that raises $\lambda_2$ drives the team, and stays. Left of the kink it raises one
# eigenvalue, right of it the other. With a step of 20 ms it jumps from one side to the other: it
# *chatters*.
#
# A sum over all of them,
#
# $$V_\Sigma = \sum_{k \ge 2} V(\lambda_k), \qquad
# \frac{\partial V_\Sigma}{\partial A_{ij}}
#   = \sum_{k\ge2} V'(\lambda_k)\,(v_{ki} - v_{kj})^2 ,$$
#
# does not change where two of its terms change places. It is smooth wherever $V$ is [Lewis1996],
# and has the same barrier, as $V_\Sigma \ge V(\lambda_2)$.
#
# ## Descent
#
# Start near the ring, and follow each gradient for eight seconds in steps of 20 ms.


# %%
def command(position, yaw, of):
    """Compute the velocities (world frame) and yaw rates that descend a potential."""
    edges = interaction_graph(position, yaw, camera)
    if of == "spectrum":
        everyone = np.ones(n, dtype=bool)
        slope = partial(negative_slope, potential=potential)
        _, action = spectral_slope(edges.weights, slope, everyone)
    else:
        found = algebraic_connectivity(edges.weights)
        action = negative_slope(found.lambda2, potential) * found.weight_gradient
    each = (action[..., None] * edges.gradients).sum(axis=-2)
    return rotate_by_yaw(each[:, :3], yaw), each[:, 3]


dt, count = 0.02, 400
times = dt * np.arange(count)
start, looking = ring(0.0)
start = start + rng.normal(size=(n, 3)) * [0.3, 0.3, 0.0]
fig, axes = plt.subplots(3, 1, figsize=(7, 5.6), sharex=True, layout="constrained")
jumps = {}
for of, color in (("lambda2", "C3"), ("spectrum", "C0")):
    position, yaw, commands, gaps, second = start, looking, [], [], []
    for _ in range(count):
        velocity, rate = command(position, yaw, of)
        values = spectrum(position, yaw)
        commands.append(velocity)
        second.append(values[1])
        gaps.append(values[2] - values[1])
        position, yaw = (
            position + dt * np.clip(velocity, -3, 3),
            yaw + dt * np.clip(rate, -1.5, 1.5),
        )
    commands = np.array(commands)
    label = "V(λ₂)" if of == "lambda2" else "Σ V(λₖ)"
    axes[0].plot(times, second, color=color, label=label)
    axes[1].semilogy(times, np.maximum(gaps, 1e-6), color=color, lw=0.8)
    changes = np.linalg.norm(np.diff(commands, axis=0), axis=2).max(axis=1)
    axes[2].semilogy(times[1:], changes, color=color, lw=0.8)
    jumps[of] = changes[100:].max()
axes[0].set(ylabel="λ₂")
axes[0].legend()
axes[1].set(ylabel="λ₃ − λ₂")
axes[2].set(xlabel="time [s]", ylabel="largest change of a\ncommand in 20 ms [m/s]")
plt.show()
for of, jump in jumps.items():
    print(f"{of}: {jump:.3f} m/s from step to step at most, after 2 s")
assert jumps["lambda2"] > 20 * jumps["spectrum"]

# %% [markdown]
# Both raise $\lambda_2$ to the same value. One does it with commands that no vehicle can follow.
#
# ## Flown
#
# The same in the whole system: cameras, messages, estimated yaws, an operator with a stick, six
# obstacles. `potential.of` chooses the potential. Robot 0 is the leader; the others are followers.

# %%
changes, runs = {}, {}
for of in ("lambda2", "spectrum"):
    settings = [f"potential.of={of}", f"duration_s={12 if small else 60}"]
    run = runs[of] = sato.run("connectivity", seed=5, overrides=settings)
    commands = run.data.velocity_command.values[100:, 1:]
    changes[of] = np.linalg.norm(np.diff(commands, axis=0), axis=2).ravel()
    assert run.data.lambda2.min() > potential.lambda2_min  # connected throughout

fig, axes = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
for (of, run), color in zip(runs.items(), ("C3", "C0"), strict=True):
    label = "V(λ₂)" if of == "lambda2" else "Σ V(λₖ)"
    axes[0].plot(run.data.time, run.data.lambda2, color=color, lw=1, label=label)
    share = 1 - np.arange(len(changes[of])) / len(changes[of])
    axes[1].loglog(np.sort(changes[of]) + 1e-6, share, color=color, label=label)
axes[0].axhline(potential.lambda2_min, color="k", lw=0.8, ls="--")
axes[0].set(xlabel="time [s]", ylabel="λ₂", ylim=(0, None))
axes[0].legend()
axes[1].set(xlabel="change of a follower's command in 20 ms [m/s]", ylabel="share above")
axes[1].set(xlim=(1e-4, 10))
plt.show()
for of, change in changes.items():
    print(of, "99.9 % of the changes are below", f"{np.percentile(change, 99.9):.3f} m/s")
assert np.percentile(changes["spectrum"], 99.9) < np.percentile(changes["lambda2"], 99.9)

# %% [markdown]
# ## Exercises
#
# ### Exercise 1
#
# The weights depend on relative positions alone. Show that $\sum_i \partial\lambda_2/\partial p_i =
# 0$, and conclude how fast the center of six robots moves while the operator steers the leader at
# 2 m/s, nothing is near and no command is limited.

# %% tags=["hide-cell"]
# Moving all robots alike changes no weight, so the derivative along (e, e, …, e) is 0. Commands of
# the potential then sum to 0; the stick v remains, and the center moves at v / N.
for _ in range(20):
    p, psi = rng.uniform(-4, 4, (n, 3)), rng.uniform(-np.pi, np.pi, n)
    for of in ("lambda2", "spectrum"):
        velocity, _ = command(p, psi, of)
        assert np.abs(velocity.sum(axis=0)).max() < 1e-9 * max(1, np.abs(velocity).max())
print(f"the center moves at {2 / n:.2f} m/s")

# %% [markdown]
# ### Exercise 2
#
# At $\lambda_2 = \lambda_3$ let $U$ be an orthonormal basis of their eigenvectors, and $\dot L$ the
# change of $L$ along a direction. Then $\lambda_2$ changes at the rate
# $\lambda_{\min}(U^T \dot L\, U)$, and the sum of the two at $\operatorname{tr}(U^T \dot L\, U)$.
# Verify both on the ring, in both senses of the stretch. Which of the two is a gradient?

# %% tags=["hide-cell"]
h = 1e-6
exact = spectrum(*ring(0.0))
_, vectors = np.linalg.eigh(laplacian(interaction_graph(*ring(0.0), camera).weights))
U = vectors[:, 1:3]
rates = []
for sense in (1, -1):
    ahead, behind = (
        laplacian(interaction_graph(*ring(sense * e), camera).weights) for e in (h, -h)
    )
    change = U.T @ (ahead - behind) @ U / (2 * h)
    moved = (spectrum(*ring(sense * h)) - exact) / h
    assert np.isclose(moved[1], np.linalg.eigvalsh(change)[0], atol=1e-4)
    assert np.isclose(moved[1] + moved[2], np.trace(change), atol=1e-4)
    rates.append((moved[1], moved[1] + moved[2]))
print(f"λ₂: {rates[0][0]:.2f} and {rates[1][0]:.2f}; sum: {rates[0][1]:.2f} and {rates[1][1]:.2f}")
# A gradient gives opposite rates in opposite directions. λ₂ falls both ways; the sum is linear.
assert rates[0][0] < 0 and rates[1][0] < 0
assert np.isclose(rates[0][1], -rates[1][1], atol=1e-4)

# %% [markdown]
# ### Exercise 3
#
# `camera.blind = true` weighs edges by range alone, as earlier work did, while the cameras still
# have their field of view. How long do such teams stay connected? Why does their own
# $\lambda_2$ not warn them?

# %% tags=["hide-cell"]
split = []
for seed in range(2 if small else 5):
    settings = ["camera.blind=true", "estimator.kind=exact", "duration_s=40"]
    run = sato.run("connectivity", seed=seed, overrides=settings)
    apart = np.flatnonzero(run.data.lambda2.values <= 0)
    split.append(run.data.time.values[apart[0]] if len(apart) else np.inf)
print("connected until [s]:", np.round(split, 1))
# Robots near each other count as neighbors where neither looks at the other. Their λ₂ is that of
# another graph, with more edges, and no term of its gradient turns a camera.
assert np.isfinite(split).any()
