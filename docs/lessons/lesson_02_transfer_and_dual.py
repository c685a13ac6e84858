# ---
# jupyter:
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Lesson 2: A fuel-optimal transfer and its dual
#
# The cost of a target is the least fuel with which an agent gets there, without regard to others
# [Morgan2016, Problem 6]:
#
# $$\begin{aligned}
#   \min_{\mathbf u}\quad & \sum_{k=0}^{T-1}\|\mathbf u[k]\|_1\,\Delta t\\
#   \text{subject to}\quad & \mathbf x[k+1] = A\mathbf x[k] + B\mathbf u[k],\quad
#     \|\mathbf u[k]\|_\infty \le U,\quad k = 0, \dots, T-1,\\
#   & \mathbf x[0] = \mathbf x_0,\quad \mathbf x[T] = \mathbf x_f .
#   \end{aligned}$$
#
# This lesson solves it, derives its dual, reads from the dual *when* to burn, and uses the dual to
# check an answer without trusting the solver that found it. The page of the
# [method](../method.md#all-auction-costs-at-once) says how the toolkit solves all pairs at once.

# %%
import os

import cvxpy as cp
import matplotlib.pyplot as plt
import numpy as np

from dynamics import ClohessyWiltshire, DoubleIntegrator, Orbit, discretize_zoh
from problems import TransferProblem, solve_minimum_fuel
from problems.minimum_fuel import reachability_matrix

small = os.environ.get("SATO_LESSON_SIZE") == "small"  # fewer steps, for tests

# %% [markdown]
# ## Eliminate the states
#
# Roll the dynamics forward: the last state is the free motion plus what each control adds,
# $\mathbf x[T] = A^T\mathbf x_0 + \sum_k A^{T-1-k}B\,\mathbf u[k]$. With all controls in one vector
# $u$ and $C = [A^{T-1}B\ \dots\ AB\ \ B]$ the program is
#
# $$\min_u\ \Delta t\,\|u\|_1 \quad\text{subject to}\quad C u = b,\quad |u_j| \le U,
#   \qquad b = \mathbf x_f - A^T\mathbf x_0 .$$
#
# A linear program with as many equations as the state has entries: four in the plane, six in space,
# whatever $T$. Take a vehicle in the plane first, from rest to rest.

# %%
dt, T, U = 1.0, 24, 0.1  # s, steps, m/s²
steps = discretize_zoh(DoubleIntegrator(2), dt, T)
start, target = np.array([0.0, 0.0, 0.0, 0.0]), np.array([6.0, 2.0, 0.0, 0.0])
b = target - steps.coast_to_end(start[None])[0]

C = np.empty((4, T, 2))
carried = np.eye(4)  # A^(T−1−k)
for k in reversed(range(T)):
    C[:, k] = carried @ steps.B[k]
    carried = carried @ steps.A[k]
assert np.allclose(C, reachability_matrix(steps))  # of sato
C = C.reshape(4, 2 * T)

u = cp.Variable(2 * T)
arrival = C @ u == b
primal = cp.Problem(cp.Minimize(dt * cp.norm1(u)), [arrival, cp.abs(u) <= U])
primal.solve(solver=cp.CLARABEL)
print(f"least fuel {primal.value:.6f} m/s")

# %% [markdown]
# ## The dual
#
# Give each equation a price $\lambda$ and drop it. Whatever $\lambda$ is, the minimum of
#
# $$\Delta t\,\|u\|_1 + \lambda^\top(b - Cu) \quad\text{over}\quad |u_j| \le U$$
#
# is at most the least fuel, since every transfer that arrives has $b - Cu = 0$. ($A^T$ is a power,
# $\lambda^\top$ a transpose.) And this minimum is easy: with $c_j$ the columns of $C$ it falls
# apart into one scalar problem per control, $\min\ \Delta t\,|u_j| - (c_j^\top\lambda)u_j$. Burn
# fully where $|c_j^\top\lambda| > \Delta t$, and not at all where it is less:
#
# $$\text{fuel} \ \ge\ \lambda^\top b - U\sum_j\max\bigl(0,\ |c_j^\top\lambda| - \Delta t\bigr)
#   \qquad\text{for every }\lambda .$$
#
# The dual program maximizes the right-hand side. It has four variables and *no constraints*. By
# duality of linear programs the best bound equals the least fuel.

# %%
price = cp.Variable(4)
bound = price @ b - U * cp.sum(cp.pos(cp.abs(C.T @ price) - dt))
dual = cp.Problem(cp.Maximize(bound))
dual.solve(solver=cp.CLARABEL)
print(f"primal {primal.value:.9f}, dual {dual.value:.9f} m/s")
assert np.isclose(primal.value, dual.value, rtol=1e-6)

# %% [markdown]
# ## The primer vector tells when to burn
#
# Put $\mathbf p[k] = (A^{T-1-k}B)^\top\lambda/\Delta t$, the *primer vector* of spacecraft
# dynamics, here of a sampled system. Then
#
# $$u_i[k] = \begin{cases}+U & p_i[k] > 1\\ -U & p_i[k] < -1\\ 0 & |p_i[k]| < 1\end{cases}
#   \qquad\text{and only } |p_i[k]| = 1 \text{ leaves a choice.}$$
#
# For a double integrator $\mathbf p$ is linear in time. So there are at most two burns, one at each
# end, and a coast between.


# %%
def draw_primer(time, controls, primer, limit, names, unit="s", scale=1.0):
    """Draw the controls of each axis above its primer vector."""
    _, axes = plt.subplots(
        2, len(names), figsize=(3.2 * len(names), 4.2), sharex=True, sharey="row",
        layout="constrained",
    )  # fmt: skip
    for i, name in enumerate(names):
        edges = np.append(time, 2 * time[-1] - time[-2])
        axes[0, i].stairs(scale * controls[:, i], edges, color="C0")
        axes[0, i].axhspan(-scale * limit, scale * limit, color="C0", alpha=0.08)
        axes[0, i].set_title(f"axis {name}")
        axes[1, i].plot(time, primer[:, i], "o-", ms=3, color="C1")
        axes[1, i].axhspan(-1, 1, color="gray", alpha=0.15)
        axes[1, i].set_xlabel(f"time [{unit}]")
    axes[0, 0].set_ylabel("u [m/s²]" if scale == 1 else "u [mm/s²]")
    axes[1, 0].set_ylabel("primer p [–]")
    plt.show()


primer = (C.T @ price.value / dt).reshape(T, 2)
draw_primer(dt * np.arange(T), u.value.reshape(T, 2), primer, U, "xy")

is_clear = np.abs(np.abs(primer) - 1) > 1e-4
rule = np.where(np.abs(primer) > 1, U * np.sign(primer), 0)
assert np.allclose(u.value.reshape(T, 2)[is_clear], rule[is_clear], atol=1e-5)

# %% [markdown]
# Gray is the band $|p| \le 1$, where the engine is off. The axis $y$ has less way to go: its burns
# are shorter than one step, the primer touches the band's edge there and leaves the size of the
# burn to the equations.
#
# ## A certificate
#
# A solver says "optimal". Believe it, or check: compute $b - Cu$, the fuel, and the bound at
# $\lambda$. If the first is zero and the others agree, $u$ *is* optimal, whoever found it. sato
# does so with every answer. `solve_minimum_fuel` shares $C$ among all targets, which makes
# thousands of these programs cheap.


# %%
def dual_bound(C, λ, b, limit, dt):
    """Compute the bound on the fuel by some λ [m/s]."""
    return λ @ b - limit * np.maximum(0, np.abs(C.T @ λ) - dt).sum()


fast = solve_minimum_fuel(steps, b[None], U, np.ones(T))
arrives = np.abs(C @ fast.u[0].ravel() - b).max()
gap = fast.fuel[0] - dual_bound(C, price.value, b, U, dt)
print(f"fuel {fast.fuel[0]:.9f} m/s, arrival error {arrives:.1e}, gap {gap:.1e} m/s")
assert arrives < 1e-9 and abs(gap) < 1e-6

# %% [markdown]
# Any other $\lambda$ also gives a true bound, only a weaker one. Shrink the best one:

# %%
for factor in (0.0, 0.5, 0.9, 1.0, 1.1):
    value = dual_bound(C, factor * price.value, b, U, dt)
    print(f"λ × {factor:.1f}: fuel ≥ {value:7.4f} m/s")
    assert value <= fast.fuel[0] + 1e-7

# %% [markdown]
# ## In orbit
#
# Nothing above used the double integrator. In orbit the primer swings: it obeys the adjoint of the
# Clohessy–Wiltshire equations, and the optimal burns sit where it leaves the band.

# %%
orbit = Orbit.from_elements(6_878e3, inclination=np.radians(45))
cw = ClohessyWiltshire.from_orbit(orbit)
minute = 60.0
count = 95  # an orbit
flight = discretize_zoh(cw, minute, count)
where = np.array([[0.0, -1000.0, 0.0], [300.0, 800.0, 200.0]])  # m
x0, xf = np.hstack([where, cw.bounded_velocity(where)])
limit = 2e-4  # m/s²
b_orbit = xf - flight.coast_to_end(x0[None])[0]
C_orbit = reachability_matrix(flight).reshape(6, -1)

scale = np.linalg.norm(C_orbit, axis=1)  # rows of meters and of meters a second
unknown = cp.Variable(3 * count)
equations = (C_orbit / scale[:, None] * limit) @ unknown == b_orbit / scale
orbital = cp.Problem(cp.Minimize(cp.norm1(unknown)), [equations, cp.abs(unknown) <= 1])
orbital.solve(solver=cp.CLARABEL)
λ = -equations.dual_value / scale * minute * limit  # CVXPY's sign; back to SI units

found = solve_minimum_fuel(flight, b_orbit[None], limit, np.ones(count))
lower = dual_bound(C_orbit, λ, b_orbit, limit, minute)
print(f"fuel {found.fuel[0]:.6f} m/s, bound {lower:.6f} m/s")
assert np.isclose(found.fuel[0], lower, rtol=1e-6)
primer = (C_orbit.T @ λ / minute).reshape(count, 3)
draw_primer(np.arange(count), found.u[0], primer, limit, "xyz", "min", 1e3)

# %% [markdown]
# The burns across the track, $z$, are half an orbit apart, where the two orbital planes cross. In
# the plane $y$ does more than $x$: a push along the track changes the size of the orbit, a push
# along the radius does not.
#
# ## The Euclidean norm
#
# With one engine that can be turned, fuel is $\sum\|\mathbf u[k]\|_2\Delta t$ and the limit
# $\|\mathbf u[k]\|_2 \le U$: a second-order cone program (Remark 1 allows $q = r = 2$). The dual
# has the norm of the primer in place of each entry,
#
# $$\text{fuel} \ge \lambda^\top b - U\,\Delta t\sum_k\max(0, \|\mathbf p[k]\|_2 - 1) .$$

# %%
one_engine = TransferProblem(steps, U, fuel_norm=2, control_norm=2)
turned = one_engine.solve(start, target)
on_axes = TransferProblem(steps, U).solve(start, target)

v = cp.Variable(4)
p = cp.reshape(C.T @ v, (T, 2), order="C") / dt
socp = cp.Maximize(v @ b - U * dt * cp.sum(cp.pos(cp.norm(p, 2, axis=1) - 1)))
cp.Problem(socp).solve(solver=cp.CLARABEL)
print(f"‖·‖₁: {on_axes.fuel:.4f} m/s")
print(f"‖·‖₂: {turned.fuel:.4f} m/s, bound {socp.value:.4f} m/s")
assert np.isclose(turned.fuel, socp.value, rtol=1e-5)
assert turned.fuel < on_axes.fuel

# %% [markdown]
# ## How long to take?
#
# Remark 2 says that longer transfers are usually cheaper. Draw it: the fuel to a few targets
# against the number of steps.

# %%
durations = np.arange(8, 61, 4 if small else 1)
figure, axes = plt.subplots(figsize=(6, 3.6), layout="constrained")
for distance, mark in ((2.0, "o"), (6.0, "s"), (18.0, "^")):
    fuel = []
    for count in durations:
        model = discretize_zoh(DoubleIntegrator(2), dt, int(count))
        ahead = np.array([[distance, 0, 0, 0]])
        fuel.append(solve_minimum_fuel(model, ahead, U, np.ones(count)).fuel[0])
    axes.plot(durations, fuel, marker=mark, ms=3, label=f"{distance:g} m")
    axes.plot(durations, 2 * distance / durations, color="gray", lw=0.8)
axes.set(xlabel="time of the transfer [s]", ylabel="least fuel [m/s]", ylim=(0, 3))
axes.legend(title="distance")
plt.show()

# %% [markdown]
# Gray is $2d/\tau$: speed up at once, coast at $d/\tau$, stop. A real engine needs time for that,
# so the fuel is a little above it; where a curve ends, the target is out of reach. Lesson 3 builds
# on $2d/\tau$.
#
# ## Exercises
#
# ### Exercise 1
#
# From rest to rest over $d$ on one axis, burn fully for $\beta$ whole steps, coast, and brake for
# $\beta$ steps. Show that $d = U\Delta t^2\beta(T - \beta)$ and that `solve_minimum_fuel` finds
# these burns.

# %% tags=["hide-cell"]
# The speed while it coasts is Uβ Δt. It lasts T − 2β steps, and both burns cover half of it:
# d = UβΔt · (T − 2β)Δt + 2 · ½UβΔt · βΔt = UΔt² β(T − β).
for β in range(1, T // 2 + 1):
    way = np.array([[U * dt**2 * β * (T - β), 0, 0, 0]])
    answer = solve_minimum_fuel(steps, way, U, np.ones(T))
    expected = np.zeros(T)
    expected[:β], expected[T - β :] = U, -U
    assert np.allclose(answer.u[0, :, 0], expected, atol=1e-9)
    assert np.isclose(answer.fuel[0], 2 * U * β * dt)

# %% [markdown]
# ### Exercise 2
#
# $\lambda$ is called a price. Show that it is the derivative of the least fuel with respect to $b$.

# %% tags=["hide-cell"]
# The best bound is λᵀb − (what does not depend on b); at its maximum over λ only the first part
# changes with b (envelope theorem). Compare with differences.
shifts = 1e-4 * np.vstack([np.eye(4), -np.eye(4)])
fuels = solve_minimum_fuel(steps, b + shifts, U, np.ones(T)).fuel
slopes = (fuels[:4] - fuels[4:]) / 2e-4
print("λ         ", np.round(price.value, 5))
print("difference", np.round(slopes, 5))
assert np.allclose(slopes, price.value, atol=1e-4)

# %% [markdown]
# ### Exercise 3
#
# The target is 30 m away, and $T = 24$ steps are too few. *Prove* it: find $\lambda$ with
# $\lambda^\top b > U\|C^\top\lambda\|_1$, and say why that is a proof. How many steps are enough?

# %% tags=["hide-cell"]
# For any u within the limit λᵀCu ≤ U ‖Cᵀλ‖₁ < λᵀb, so Cu = b is impossible. In the bound above
# this is a direction along which the dual grows without end.
far = np.array([30.0, 0, 0, 0])
ray = cp.Variable(4)
margin = cp.Problem(cp.Maximize(ray @ far - U * cp.norm1(C.T @ ray)), [cp.norm_inf(ray) <= 1])
margin.solve(solver=cp.CLARABEL)
assert ray.value @ far > U * np.abs(C.T @ ray.value).sum() + 1e-3
assert solve_minimum_fuel(steps, far[None], U, np.ones(T)).fuel[0] == np.inf
# The most that T steps cover is U Δt² T²/4 for even T: 34.6 → 35 steps. Exercise 1 with β = T/2.
enough = next(
    n
    for n in range(T, 100)
    if solve_minimum_fuel(
        discretize_zoh(DoubleIntegrator(2), dt, n), far[None], U, np.ones(n)
    ).fuel[0]
    < np.inf
)
print(f"{enough} steps")
assert U * (enough / 2) ** 2 >= 30 > U * ((enough - 1) / 2) ** 2
