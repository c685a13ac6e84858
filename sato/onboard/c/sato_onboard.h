/* One agent's transfer among half-spaces, solved in C.
 *
 *     minimize    dt sum_k w[k] |u[k]|_1                            w: about 1, largest midway
 *     subject to  x[k+1] = A x[k] + B u[k] + z,  x[0] = start,  x[T] = goal
 *                 |u[k]|_inf <= SATO_MAX_CONTROL
 *                 |velocity[k]|_2 <= SATO_MAX_SPEED,  k = 1 ... T-1     if SATO_LIMITED
 *                 on_state . x[k] + on_control . u[k] >= least          for each half-space
 *
 * SI units throughout. The sizes and limits of sato_model.h are compiled in. The workspace is
 * static, so calls must not overlap. A result does not depend on earlier calls.
 */
#ifndef SATO_ONBOARD_H
#define SATO_ONBOARD_H

#include "sato_model.h"

#if defined(__GNUC__)
#define SATO_API __attribute__((visibility("default")))
#else
#define SATO_API
#endif

#define SATO_TOLERANCE 1e-6

/* Return values of sato_solve. */
#define SATO_SOLVED 0   /* every residual is within SATO_TOLERANCE */
#define SATO_UNSOLVED 1 /* infeasible, or no solution found; no proof of either */
#define SATO_REFUSED 2  /* a number is not finite, or there are too many half-spaces */

/* on_state . x[step] + on_control . u[step] >= least */
typedef struct {
  int step; /* 0 ... SATO_HORIZON - 1; at most SATO_ROWS half-spaces per step */
  double on_state[SATO_STATE];
  double on_control[SATO_AXES];
  double least;
} sato_half_space;

/* A flight and its errors, all recomputed from u, the data and the solver's duals. */
typedef struct {
  double u[SATO_STEPS][SATO_AXES]; /* accelerations, each held over a step [m/s2] */
  double fuel;                     /* dt sum_k |u[k]|_1 [m/s] */
  double cost;                     /* the objective: the same with weights w [m/s] */
  double missed_position;          /* |x[T] - goal|, largest component [m] */
  double missed_velocity;          /* the same for the velocity [m/s] */
  double broken;                   /* largest violation of a half-space, in the unit of its least */
  double too_fast;                 /* largest excess over the speed limit [m/s] */
  double residual;                 /* largest of all residuals and the gap, relative */
} sato_flight;

/* Solve for a transfer from start to goal inside half-spaces.
 *
 * start, goal: position, then velocity [m, m/s].
 * spaces, count: the half-spaces, in any order; count may be 0.
 * flight: the result. Unless SATO_SOLVED is returned it is not a solution: it holds the point at
 *     which the solver stopped, or, with an infinite residual, nothing.
 */
SATO_API int sato_solve(const double start[SATO_STATE], const double goal[SATO_STATE],
                        const sato_half_space spaces[], int count, sato_flight *flight);

#endif
