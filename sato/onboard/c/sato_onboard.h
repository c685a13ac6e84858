/* One agent's transfer among half-spaces, solved in C.
 *
 *     minimise    dt sum_k w[k] |u[k]|_1                            w: 1, and a little more midway
 *     subject to  x[k+1] = A x[k] + B u[k] + z,  x[0] = start,  x[T] = goal
 *                 |u[k]|_inf <= SATO_MAX_CONTROL
 *                 |velocity[k]|_2 <= SATO_MAX_SPEED,  k = 1 ... T-1     if SATO_LIMITED
 *                 on_state . x[k] + on_control . u[k] >= least          a half-space each
 *
 * SI units throughout. Sizes and limits are those of sato_model.h and are compiled in. One
 * call at a time: the workspace is static. An answer depends on no call before it.
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

/* What sato_solve returns. */
#define SATO_SOLVED 0   /* every residual of the answer is within SATO_TOLERANCE */
#define SATO_UNSOLVED 1 /* no such answer: there is none, or it was not found; no proof of either */
#define SATO_REFUSED 2  /* a number that is not finite, or half-spaces that there is no room for */

/* on_state . x[step] + on_control . u[step] >= least */
typedef struct {
  int step; /* 0 ... SATO_HORIZON - 1, and no more than SATO_ROWS of the same */
  double on_state[SATO_STATE];
  double on_control[SATO_AXES];
  double least;
} sato_half_space;

/* A flight, and how far it can be trusted: all of it is recomputed from u, the data and the
 * solver's duals, and none of it is the solver's word. */
typedef struct {
  double u[SATO_STEPS][SATO_AXES]; /* accelerations, each held over a step [m/s2] */
  double fuel;                     /* dt sum_k |u[k]|_1 [m/s] */
  double cost;                     /* what is minimised: the same with the weights [m/s] */
  double missed_position;          /* |x[T] - goal|, largest component [m] */
  double missed_velocity;          /* the same of the velocity [m/s] */
  double broken;                   /* largest break of a half-space, in the unit of its least */
  double too_fast;                 /* by how much the speed limit is broken [m/s] */
  double residual;                 /* the largest of all residuals and the gap, relative */
} sato_flight;

/* Fly from start to goal inside half-spaces.
 *
 * start, goal: position, then velocity [m, m/s].
 * spaces, count: the half-spaces, in any order; none may be needed.
 * flight: where the answer goes. Unless SATO_SOLVED is returned it is none: it holds the point
 *     at which the solver stopped, or, with an infinite residual, nothing.
 */
SATO_API int sato_solve(const double start[SATO_STATE], const double goal[SATO_STATE],
                        const sato_half_space spaces[], int count, sato_flight *flight);

#endif
