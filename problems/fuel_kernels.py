"""Compiled kernels of `problems.fuel_program`: rows that join, and dual simplex pivots."""

from typing import no_type_check

import numba
import numpy as np

from problems.kernels import compiled

ZERO_ENTRY = 1e-10  # over the norm of its row: an entry of the tableau that counts as zero
MIN_RELATIVE_PIVOT = 1e-1  # of the largest entry among the kinks that are passed
SMALL_PIVOT = 1e-5  # after which the tableau is computed anew
REFRESH_PIVOTS = 100  # after which the tableau is computed anew
FAR = 1e30  # a kink that is never reached
TINY = float(np.finfo(float).tiny)
OPTIMAL, INFEASIBLE, STOPPED = 0, 1, 2


@compiled(nogil=True, error_model="numpy")
@no_type_check
def append_rows(
    first,
    coeffs,
    offset,
    row_kinks,
    penalty,
    room,
    is_relaxed,
    kinks,
    slopes,
    place,
    nonbasic,
    basic,
    own_coeffs,
    own_offset,
    own_room,
    tableau,
    value,
):
    """Write rows from the first on, scaled to a norm of 1, with their slacks in the basis.

    After `is_relaxed` all arguments are arrays of the program; those by row are longer already.
    """
    n = tableau.shape[1]
    x = np.empty(n)
    for j in range(n):
        if nonbasic[j] < n:
            x[nonbasic[j]] = kinks[nonbasic[j], place[nonbasic[j]]]
    for i in range(first):
        if basic[i] < n:
            x[basic[i]] = value[i]
    for k in range(len(offset)):
        row, slack, square = first + k, n + first + k, 0.0
        for j in range(n - 1):
            square += coeffs[k, j] ** 2
        size = np.sqrt(square) if square > TINY else 1.0
        for j in range(n - 1):
            own_coeffs[row, j] = coeffs[k, j] / size
        own_coeffs[row, n - 1] = is_relaxed / size
        own_offset[row], own_room[row] = offset[k] / size, room[k] / size
        value[row] = own_offset[row]
        for j in range(n):
            value[row] += own_coeffs[row, j] * x[j]
            is_control = nonbasic[j] < n
            tableau[row, j] = own_coeffs[row, nonbasic[j]] if is_control else 0.0
        for i in range(first):
            if basic[i] < n and own_coeffs[row, basic[i]] != 0.0:
                for j in range(n):
                    tableau[row, j] += own_coeffs[row, basic[i]] * tableau[i, j]
        for j in range(len(row_kinks)):
            kinks[slack, j] = row_kinks[j]
        slopes[slack, 0], slopes[slack, 1] = -penalty[k] * size, 0.0
        slopes[slack, 2], slopes[slack, 3] = penalty[k] * size, np.inf
        place[slack], basic[row] = 1, slack


@compiled(nogil=True, error_model="numpy")
@no_type_check
def ascend(kinks, slopes, place, nonbasic, basic, tableau, value, price, ray, tolerance):
    """Pivot until all basic variables are in their segments, or the dual is unbounded.

    Changes all but kinks and slopes, and writes the ray along which it is unbounded.

    It returns the status and the number of pivots.
    """
    (m, n), pivots = tableau.shape, 0
    step, drop, entry = np.empty(2 * n + 2), np.empty(2 * n + 2), np.empty(n + 1)
    candidate, passed = np.empty(2 * n + 2, np.int64), np.empty(2 * n + 2, np.int64)
    while pivots < REFRESH_PIVOTS:
        leaving, violation, sign, norm = _choose_leaving(
            kinks, place, basic, tableau, value, tolerance
        )
        if leaving < 0:
            return OPTIMAL, pivots
        own, count = basic[leaving], 0
        own_price = slopes[own, place[own]]
        place[own] += sign > 0
        # The last candidate is the leaving variable itself, which may pass its kink and stay.
        for j in range(n + 1):
            entry[j] = sign if j == n else -sign * tableau[leaving, j]
            if abs(entry[j]) <= ZERO_ENTRY * norm:
                continue
            variable = own if j == n else nonbasic[j]
            at, way = place[variable], 1 if entry[j] > 0 else -1
            for _ in range(2):
                bound = slopes[variable, at - (way < 0)]
                if abs(bound) == np.inf:
                    break
                past = bound - (own_price if j == n else price[j])
                step[count], candidate[count] = max(past / entry[j], 0.0), j
                length = abs(kinks[variable, at + way] - kinks[variable, at])
                drop[count] = length * abs(entry[j])
                count, at = count + 1, at + way
                if length == FAR:
                    break
        last = _choose_entering(step, drop, candidate, entry, passed, count, violation, tolerance)
        if last < 0:
            place[own] -= sign > 0
            for j in range(n + m):
                ray[j] = 0.0
            for j in range(n):
                ray[nonbasic[j]] = entry[j]
            ray[own] = sign
            return INFEASIBLE, pivots
        pivots += 1
        for k in range(last):
            j = candidate[passed[k]]
            variable, way = own if j == n else nonbasic[j], 1 if entry[j] > 0 else -1
            jump = kinks[variable, place[variable] + way] - kinks[variable, place[variable]]
            place[variable] += way
            if j < n and jump != 0.0:
                for i in range(m):
                    value[i] += tableau[i, j] * jump
        enter, length = candidate[passed[last]], step[passed[last]]
        for j in range(n):
            price[j] -= sign * length * tableau[leaving, j]
        if enter == n:
            place[own] -= sign < 0
            continue
        variable, pivot = nonbasic[enter], tableau[leaving, enter]
        start = kinks[variable, place[variable]]
        move = (kinks[own, place[own]] - value[leaving]) / pivot
        for i in range(m):
            value[i] += tableau[i, enter] * move
        value[leaving] = start + move
        place[variable] -= entry[enter] < 0
        basic[leaving], nonbasic[enter] = variable, own
        price[enter] = own_price + sign * length
        _exchange(tableau, leaving, enter)
        if abs(pivot) < SMALL_PIVOT:
            break
    return STOPPED, pivots


@numba.njit(error_model="numpy")
@no_type_check
def _choose_leaving(kinks, place, basic, tableau, value, tolerance):
    # Steepest ascent: violation over the norm of the row.
    leaving, largest, sign, norm, steepest = -1, 0.0, 0.0, 0.0, 0.0
    for i in range(len(basic)):
        v = basic[i]
        below, above = kinks[v, place[v]] - value[i], value[i] - kinks[v, place[v] + 1]
        violation = max(below, above)
        if violation <= tolerance or violation**2 <= steepest:
            continue
        square, row = 1.0, tableau[i]
        for j in range(len(row)):
            square += row[j] ** 2
        if violation**2 > steepest * square:
            leaving, largest, steepest = i, violation, violation**2 / square
            norm = np.sqrt(square)
            sign = 1.0 if above > below else -1.0
    return leaving, largest, sign, norm


@numba.njit(error_model="numpy")
@no_type_check
def _choose_entering(step, drop, candidate, entry, passed, count, slope, tolerance):
    # Passes kinks, the nearest first, until the dual descends; then goes back to a safe pivot.
    # Written: their order. Returns the place of the one that ends the ascent, or −1.
    largest, last = 0.0, -1
    for k in range(count):
        passed[k] = k
    for k in range(count):
        first = k
        for other in range(k + 1, count):
            if step[passed[other]] < step[passed[first]]:
                first = other
        passed[k], passed[first] = passed[first], passed[k]
        own = abs(entry[candidate[passed[k]]])
        largest = max(largest, own)
        if own >= MIN_RELATIVE_PIVOT * largest:
            last = k
        slope -= drop[passed[k]]
        if slope <= 0.0:
            return last
    return last if slope <= tolerance else -1


@numba.njit(error_model="numpy")
@no_type_check
def _exchange(tableau, leaving, enter):
    # Exchanges a basic and a nonbasic variable.
    m, n = tableau.shape
    row, pivot = tableau[leaving], tableau[leaving, enter]
    for j in range(n):
        row[j] /= -pivot
    row[enter] = 1.0 / pivot
    for i in range(m):
        factor, own = tableau[i, enter], tableau[i]
        if factor == 0.0 or i == leaving:
            continue
        own[enter] = 0.0
        for j in range(n):
            own[j] += factor * row[j]
