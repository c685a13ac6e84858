/* Data input, call of the generated solver, and verification of its solution. */
#include "sato_onboard.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "cpg_solve.h"
#include "sato_numbers.h"

#define ALL_ROWS (SATO_HORIZON * SATO_ROWS)
#define ASKED 1e-9 /* the solver's tolerance, well below SATO_TOLERANCE */

static double coast[SATO_STEPS + 1][SATO_STATE]; /* states of the free motion */
static double path[SATO_STEPS + 1][SATO_STATE];
static double unit_of[ALL_ROWS]; /* scale of a row, in the unit of its least */

static double worse(double a, double b) { return a >= b || a != a ? a : b; } /* NaN counts as the larger */

static int finite_all(const double *numbers, int count) {
  for (int i = 0; i < count; i++)
    if (!isfinite(numbers[i])) return 0;
  return 1;
}

static double dot(const double *a, const double *b, int count) {
  double sum = 0;
  for (int i = 0; i < count; i++) sum += a[i] * b[i];
  return sum;
}

static double largest(const double *numbers, int count) {
  double most = 0;
  for (int i = 0; i < count; i++) most = worse(most, fabs(numbers[i]));
  return most;
}

static void roll(const double start[SATO_STATE], double u[][SATO_AXES],
                 double x[][SATO_STATE]) {
  memcpy(x[0], start, sizeof x[0]);
  for (int k = 0; k < SATO_STEPS; k++)
    for (int i = 0; i < SATO_STATE; i++)
      x[k + 1][i] = dot(sato_A[i], x[k], SATO_STATE) + sato_z[i] +
                    (u ? dot(sato_B[i], u[k], SATO_AXES) : 0);
}

/* Write a half-space into its row, relative to the free motion and scaled to the order of 1. */
static void put(int row, const sato_half_space *space) {
  double on_state[SATO_STATE], on_control[SATO_AXES];
  double room = dot(space->on_state, coast[space->step], SATO_STATE) - space->least;
  double size = 0;
  for (int i = 0; i < SATO_STATE; i++) {
    /* No control changes the first state. */
    on_state[i] = space->step ? -space->on_state[i] * sato_units[i] : 0;
    size = worse(size, fabs(on_state[i]));
  }
  for (int i = 0; i < SATO_AXES; i++) {
    on_control[i] = -space->on_control[i] * SATO_MAX_CONTROL;
    size = worse(size, fabs(on_control[i]));
  }
  if (size == 0) size = worse(fabs(room), 1); /* constant row: its unit is a meter */
  for (int i = 0; i < SATO_STATE; i++)
    cpg_update_on_state(row * SATO_STATE + i, on_state[i] / size);
  for (int i = 0; i < SATO_AXES; i++)
    cpg_update_on_control(row * SATO_AXES + i, on_control[i] / size);
  cpg_update_room(row, room / size);
  unit_of[row] = size;
}

static void clear(int row) {
  for (int i = 0; i < SATO_STATE; i++) cpg_update_on_state(row * SATO_STATE + i, 0);
  for (int i = 0; i < SATO_AXES; i++) cpg_update_on_control(row * SATO_AXES + i, 0);
  cpg_update_room(row, 1);
}

/* Write all data of the program; return 0 if they are invalid or there is no room. */
static int fill(const double goal[SATO_STATE], const sato_half_space spaces[], int count) {
  int used[SATO_HORIZON] = {0};
  for (int s = 0; s < count; s++) {
    const sato_half_space *space = &spaces[s];
    if (space->step < 0 || space->step >= SATO_HORIZON) return 0;
    if (used[space->step] == SATO_ROWS) return 0;
    if (!finite_all(space->on_state, SATO_STATE) || !finite_all(space->on_control, SATO_AXES) ||
        !isfinite(space->least))
      return 0;
    put(space->step * SATO_ROWS + used[space->step]++, space);
  }
  for (int k = 0; k < SATO_HORIZON; k++)
    for (int r = used[k]; r < SATO_ROWS; r++) clear(k * SATO_ROWS + r);
  for (int i = 0; i < SATO_STATE; i++)
    cpg_update_reach(i, (goal[i] - coast[SATO_STEPS][i]) / sato_units[i]);
#if SATO_LIMITED
  for (int k = 1; k < SATO_STEPS; k++)
    for (int i = 0; i < SATO_AXES; i++)
      cpg_update_coasting((k - 1) * SATO_AXES + i, coast[k][SATO_AXES + i] / SATO_MAX_SPEED);
#endif
  cpg_canonicalize_b();
  cpg_canonicalize_G();
  cpg_canonicalize_h();
  return 1;
}

/* sum += M v, or sum += M' v. */
static void add(const cpg_csc *M, int columns, const double *v, double *sum, int transposed) {
  for (int j = 0; j < columns; j++)
    for (int e = M->p[j]; e < M->p[j + 1]; e++) {
      if (transposed) sum[j] += M->x[e] * v[M->i[e]];
      else sum[M->i[e]] += M->x[e] * v[j];
    }
}

/* Largest violation of the cones by s; they are self-dual. */
static double outside(const double *s) {
  double most = 0;
  for (int i = 0; i < SATO_LINEAR; i++) most = worse(most, -s[i]);
  for (int c = 0; c < SATO_CONES; c++) {
    const double *t = s + SATO_LINEAR + c * (SATO_AXES + 1);
    most = worse(most, sqrt(dot(t + 1, t + 1, SATO_AXES)) - t[0]);
  }
  return most;
}

/* Return the largest of primal residual, dual residual and gap, as in problems/conic.py. */
static double judged(const QOCOSolution *said) {
  static double below[SATO_EQUATIONS], s[SATO_INEQUALITIES], slope[SATO_VARIABLES];
  const Canon_Params_t *data = &Canon_Params;
  const double *x = said->x, *y = said->y, *z = said->z;
  memset(below, 0, sizeof below);
  memset(s, 0, sizeof s);
  memcpy(slope, data->c, sizeof slope);
  add(data->A, SATO_VARIABLES, x, below, 0);
  add(data->G, SATO_VARIABLES, x, s, 0);
  add(data->A, SATO_VARIABLES, y, slope, 1);
  add(data->G, SATO_VARIABLES, z, slope, 1);
  for (int i = 0; i < SATO_EQUATIONS; i++) below[i] -= data->b[i];
  for (int i = 0; i < SATO_INEQUALITIES; i++) s[i] = data->h[i] - s[i];
  double right = worse(largest(data->b, SATO_EQUATIONS), largest(data->h, SATO_INEQUALITIES));
  double value = dot(data->c, x, SATO_VARIABLES);
  double dual = dot(data->b, y, SATO_EQUATIONS) + dot(data->h, z, SATO_INEQUALITIES);
  double residual = worse(largest(below, SATO_EQUATIONS), outside(s)) / (1 + right);
  residual = worse(residual, worse(largest(slope, SATO_VARIABLES), outside(z)) /
                                 (1 + largest(data->c, SATO_VARIABLES)));
  return worse(residual, fabs(value + dual) / (1 + fabs(value)));
}

/* Simulate the controls in SI units, and return the largest relative violation. */
static double flown(const double start[SATO_STATE], const double goal[SATO_STATE],
                    const sato_half_space spaces[], int count, sato_flight *flight) {
  double residual = 0;
  int used[SATO_HORIZON] = {0};
  roll(start, flight->u, path);
  for (int k = 0; k < SATO_STEPS; k++)
    for (int i = 0; i < SATO_AXES; i++) {
      flight->fuel += SATO_STEP * fabs(flight->u[k][i]);
      flight->cost += SATO_STEP * sato_weight[k] * fabs(flight->u[k][i]);
    }
  for (int i = 0; i < SATO_STATE; i++) {
    double miss = fabs(path[SATO_STEPS][i] - goal[i]);
    double *most = i < SATO_AXES ? &flight->missed_position : &flight->missed_velocity;
    *most = worse(*most, miss);
    residual = worse(residual, miss / sato_units[i]);
  }
  for (int s = 0; s < count; s++) {
    const sato_half_space *space = &spaces[s];
    double kept = dot(space->on_state, path[space->step], SATO_STATE) +
                  dot(space->on_control, flight->u[space->step], SATO_AXES);
    double miss = space->least - kept;
    flight->broken = worse(flight->broken, miss);
    int row = space->step * SATO_ROWS + used[space->step]++;
    residual = worse(residual, miss / unit_of[row]);
  }
#if SATO_LIMITED
  for (int k = 1; k < SATO_STEPS; k++) {
    const double *v = path[k] + SATO_AXES;
    double over = sqrt(dot(v, v, SATO_AXES)) - SATO_MAX_SPEED;
    flight->too_fast = worse(flight->too_fast, over);
    residual = worse(residual, over / SATO_MAX_SPEED);
  }
#endif
  return residual;
}

static int answered(const double start[SATO_STATE], const double goal[SATO_STATE],
                    const sato_half_space spaces[], int count, sato_flight *flight) {
  const QOCOSolution *said = qoco_solver->sol;
  /* Only these statuses come with a point; its residuals decide whether it is a solution. */
  if (said->status != QOCO_SOLVED && said->status != QOCO_SOLVED_INACCURATE)
    return SATO_UNSOLVED;
  cpg_retrieve_prim();
  double controls = 0;
  for (int k = 0; k < SATO_STEPS; k++)
    for (int i = 0; i < SATO_AXES; i++) {
      double u = CPG_Prim.plus[k * SATO_AXES + i] - CPG_Prim.minus[k * SATO_AXES + i];
      controls = worse(controls, fabs(u));
      u = u > 1 ? 1 : u < -1 ? -1 : u;
      flight->u[k][i] = SATO_MAX_CONTROL * u;
    }
  double found = judged(said);
  flight->residual = worse(found, flown(start, goal, spaces, count, flight));
  return controls - 1 <= SATO_TOLERANCE && flight->residual <= SATO_TOLERANCE ? SATO_SOLVED
                                                                              : SATO_UNSOLVED;
}

/* Allocate the workspace, once. */
static int set_up(void) {
  QOCOCscMatrix A, G;
  QOCOSettings settings;
  Canon_Params_t *data = &Canon_Params;
  qoco_set_csc(&A, SATO_EQUATIONS, SATO_VARIABLES, data->A->nnz, data->A->x, data->A->p,
               data->A->i);
  qoco_set_csc(&G, SATO_INEQUALITIES, SATO_VARIABLES, data->G->nnz, data->G->x, data->G->p,
               data->G->i);
  set_default_settings(&settings);
  settings.abstol = settings.reltol = ASKED;
#if SATO_CONES
  int *sizes = (int *)qoco_q;
#else
  int *sizes = NULL;
#endif
  QOCOSolver *solver = calloc(1, sizeof *solver);
  if (!solver) return 0;
  if (qoco_setup(solver, SATO_VARIABLES, SATO_INEQUALITIES, SATO_EQUATIONS, NULL, data->c, &A,
                 data->b, &G, data->h, SATO_LINEAR, SATO_CONES, sizes, &settings)) {
    free(solver); /* memory that it has allocated itself is lost */
    return 0;
  }
  qoco_solver = solver;
  return 1;
}

/* Reset the scaling. QOCO 0.2.2 computes its initial point with the scaling of the last solve,
 * which may have been nearly singular, where it should use none. */
static void forget(void) {
  double *scaling = get_data_vectorf(qoco_solver->work->WtW);
  memset(scaling, 0, qoco_solver->work->Wnnz * sizeof *scaling);
  for (int i = 0; i < SATO_LINEAR; i++) scaling[i] = 1;
  scaling += SATO_LINEAR;
  for (int c = 0; c < SATO_CONES; c++) /* upper triangles, column by column */
    for (int size = 1; size <= SATO_AXES + 1; size++) {
      scaling[size - 1] = 1;
      scaling += size;
    }
  qoco_solver->linsys->linsys_update_nt(qoco_solver->linsys_data, qoco_solver->work->WtW,
                                        qoco_solver->settings->kkt_static_reg,
                                        SATO_INEQUALITIES);
}

static int begin(void) {
  if (!qoco_solver && !set_up()) return 0;
  update_vector_data(qoco_solver, NULL, Canon_Params.b, Canon_Params.h);
  update_matrix_data(qoco_solver, NULL, NULL, Canon_Params.G->x);
  forget();
  return 1;
}

int sato_solve(const double start[SATO_STATE], const double goal[SATO_STATE],
               const sato_half_space spaces[], int count, sato_flight *flight) {
  memset(flight, 0, sizeof *flight);
  flight->residual = INFINITY;
  if (!finite_all(start, SATO_STATE) || !finite_all(goal, SATO_STATE) || count < 0)
    return SATO_REFUSED;
  roll(start, NULL, coast);
  if (!fill(goal, spaces, count)) return SATO_REFUSED;

  if (!begin()) return SATO_UNSOLVED;
  qoco_solve(qoco_solver);
  return answered(start, goal, spaces, count, flight);
}
