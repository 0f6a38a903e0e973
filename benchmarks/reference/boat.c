/* Zig-zags of many twin-thruster boats, every switch located inside its step or made at the first
 * sample beyond the check heading: the reference of the part `engine`. Compiled twice, with REAL as
 * double and as float.
 *
 * Boats lie side by side in blocks of LANES, each number in an array of its own, so that a step of a
 * block is vector instructions throughout; blocks are shared out among threads. What switches within
 * a step is rare and done boat by boat.
 */
#include <math.h>
#include <string.h>

#ifndef REAL
#define REAL double
#endif
#ifndef LANES
#define LANES 64
#endif
#define INLINE static inline __attribute__((always_inline))

enum { M, I_Z, X_UDOT, Y_VDOT, N_RDOT, X_U, X_UU, Y_V, N_R, N_RR, THRUST, LAG, SPEED, PARAMETERS };
enum { M11 = PARAMETERS, M22, PER_M11, PER_M22, PER_M33, CONSTANTS };
enum { X, Y, PSI, U, V, R, PORT, STARBOARD, STATES };

static const REAL ARM = (REAL)1.03, MOST = 250, LEAST = -180, HARD_OVER = (REAL)0.6108652381980153;

/* Blocks of boats, and one of them: numbers by name, for loops over arrays are not unrolled in time to
 * become vector instructions. */
typedef struct { REAL p[CONSTANTS][LANES]; } Boats;
typedef struct { REAL s[STATES][LANES]; } States;
typedef struct { REAL m11, m22, per_m11, per_m22, per_m33, x_u, x_uu, y_v, n_r, n_rr, thrust, lag; } Boat;
typedef struct { REAL x, y, psi, u, v, r, port, starboard; } State;
typedef struct { REAL x, y, psi, u, v, r; } Rate;

INLINE Boat boat_of(const Boats *b, int i)
{
    return (Boat){b->p[M11][i], b->p[M22][i], b->p[PER_M11][i], b->p[PER_M22][i], b->p[PER_M33][i],
                  b->p[X_U][i], b->p[X_UU][i], b->p[Y_V][i], b->p[N_R][i], b->p[N_RR][i],
                  b->p[THRUST][i], b->p[LAG][i]};
}

INLINE State state_of(const States *s, int i)
{
    return (State){s->s[X][i], s->s[Y][i], s->s[PSI][i], s->s[U][i],
                   s->s[V][i], s->s[R][i], s->s[PORT][i], s->s[STARBOARD][i]};
}

INLINE void keep(States *to, int i, State s)
{
    to->s[X][i] = s.x;
    to->s[Y][i] = s.y;
    to->s[PSI][i] = s.psi;
    to->s[U][i] = s.u;
    to->s[V][i] = s.v;
    to->s[R][i] = s.r;
    to->s[PORT][i] = s.port;
    to->s[STARBOARD][i] = s.starboard;
}

/* Sine and cosine without a branch, so that the loop around them becomes vector instructions: the
 * remainder of quarter turns (Cody and Waite), then Taylor series on an eighth of a turn to both
 * sides, exchanged and signed by the quarter. */
INLINE void sine_cosine(REAL a, REAL *sine, REAL *cosine)
{
    REAL k = __builtin_rint(a * (REAL)0.63661977236758134308);
    REAL b = a - k * (REAL)1.5703125 - k * (REAL)4.837512969970703125e-4
             - k * (REAL)7.54978995489188216e-8;
    REAL c = b * b, s, q, half = (REAL)0.5 * k, odd, second;
    odd = k - 2 * __builtin_floor(half);
    second = __builtin_floor(half) - 2 * __builtin_floor((REAL)0.25 * k);
    s = (REAL)-7.6471637318198164e-13;
    q = (REAL)4.7794773323873853e-14;
    q = q * c + (REAL)-1.1470745597729725e-11;
#define TERM(A, B) s = s * c + (REAL)(A); q = q * c + (REAL)(B);
    TERM(1.6059043836821613e-10, 2.0876756987868099e-09)
    TERM(-2.5052108385441718e-08, -2.7557319223985891e-07)
    TERM(2.7557319223985893e-06, 2.4801587301587302e-05)
    TERM(-1.9841269841269841e-04, -1.3888888888888889e-03)
    TERM(8.3333333333333333e-03, 4.1666666666666667e-02)
    TERM(-1.6666666666666667e-01, -0.5)
    s = b + b * c * s;
    q = 1 + c * q;
    *sine = (odd != 0 ? q : s) * (1 - 2 * second);
    *cosine = (odd != 0 ? s : q) * (1 - 2 * (odd != second ? (REAL)1 : (REAL)0));
}

INLINE Rate rate(Boat b, State s)
{
    REAL sine, cosine;
    sine_cosine(s.psi, &sine, &cosine);
    return (Rate){
        s.u * cosine - s.v * sine,
        s.u * sine + s.v * cosine,
        s.r,
        (b.m22 * s.v * s.r + (b.x_u + b.x_uu * (REAL)fabs(s.u)) * s.u + s.port + s.starboard) * b.per_m11,
        (b.y_v * s.v - b.m11 * s.u * s.r) * b.per_m22,
        ((b.m11 - b.m22) * s.u * s.v + (b.n_r + b.n_rr * (REAL)fabs(s.r)) * s.r
         + ARM * (s.port - s.starboard)) * b.per_m33};
}

INLINE State moved(State s, Rate k, REAL dt, REAL port, REAL starboard)
{
    return (State){s.x + dt * k.x, s.y + dt * k.y, s.psi + dt * k.psi, s.u + dt * k.u,
                   s.v + dt * k.v, s.r + dt * k.r, port, starboard};
}

/* A classical Runge-Kutta step; the lag's exponential is known at its nodes: half and whole are what
 * is left of a deviation after half the step and after all of it. */
INLINE State step(Boat b, State s, REAL to_port, REAL to_starboard, REAL dt, REAL half, REAL whole)
{
    REAL off_port = s.port - to_port, off_starboard = s.starboard - to_starboard;
    REAL port = to_port + off_port * half, starboard = to_starboard + off_starboard * half;
    REAL port_then = to_port + off_port * whole, starboard_then = to_starboard + off_starboard * whole;
    Rate k1 = rate(b, s);
    Rate k2 = rate(b, moved(s, k1, (REAL)0.5 * dt, port, starboard));
    Rate k3 = rate(b, moved(s, k2, (REAL)0.5 * dt, port, starboard));
    Rate k4 = rate(b, moved(s, k3, dt, port_then, starboard_then));
#define MEAN(N) (k1.N + 2 * (k2.N + k3.N) + k4.N)
    Rate mean = {MEAN(x), MEAN(y), MEAN(psi), MEAN(u), MEAN(v), MEAN(r)};
    return moved(s, mean, dt / 6, port_then, starboard_then);
}

INLINE void targets(REAL thrust, REAL side, REAL angle, REAL *port, REAL *starboard)
{
    REAL share = side * angle / HARD_OVER;
    REAL a = thrust * (1 + share), b = thrust * (1 - share);
    a = a < LEAST ? LEAST : a;
    b = b < LEAST ? LEAST : b;
    *port = a > MOST ? MOST : a;
    *starboard = b > MOST ? MOST : b;
}

/* Where in [0, 1] the cubic of two values and two slopes passes zero, by Newton's method. */
static REAL cubic_root(REAL first, REAL last, REAL begin, REAL end)
{
    REAL curve = 3 * (last - first) - 2 * begin - end, twist = begin + end - 2 * (last - first);
    REAL at = -first / (last > first ? last - first : 1);
    for (int i = 0; i < 4; i++)
        at -= (first + at * (begin + at * (curve + at * twist)))
              / (begin + at * (2 * curve + 3 * at * twist));
    return at;
}

/* The step of one boat that passes its check heading: to the switch by two corrected probes, on to
 * the end of the step in the new orders. Returns when, from the step's begin. */
static REAL switching_step(Boat b, State *s, REAL *side, REAL angle, REAL check, REAL dt)
{
    REAL port, starboard, to;
    State probe;
    targets(b.thrust, *side, angle, &port, &starboard);
#define STEP(FROM, T) step(b, FROM, port, starboard, T, (REAL)exp(-(T) / (2 * b.lag)), (REAL)exp(-(T) / b.lag))
    probe = STEP(*s, dt);
    to = dt * cubic_root(*side * s->psi - check, *side * probe.psi - check, dt * *side * s->r,
                         dt * *side * probe.r);
    for (int i = 0; i < 2; i++) {
        probe = STEP(*s, to);
        to -= (*side * probe.psi - check) / (*side * probe.r);
    }
    probe = STEP(*s, to);
    *side = -*side;
    targets(b.thrust, *side, angle, &port, &starboard);
    *s = STEP(probe, dt - to);
    return to;
}

static void block(const Boats *boats, int located, long steps, REAL dt, REAL angle, REAL check,
                  long most, States *now, REAL *switches)
{
    REAL side[LANES], half[LANES], whole[LANES];
    int count[LANES];
    States next;
    for (int i = 0; i < LANES; i++) {
        side[i] = 1;
        count[i] = 0;
        half[i] = (REAL)exp(-dt / (2 * boats->p[LAG][i]));
        whole[i] = (REAL)exp(-dt / boats->p[LAG][i]);
    }
    for (long n = 0; n < steps; n++) {
        int passed = 0;
#pragma omp simd reduction(| : passed)
        for (int i = 0; i < LANES; i++) {
            REAL port, starboard;
            Boat b = boat_of(boats, i);
            targets(b.thrust, side[i], angle, &port, &starboard);
            State after = step(b, state_of(now, i), port, starboard, dt, half[i], whole[i]);
            keep(&next, i, after);
            passed |= side[i] * after.psi >= check;
        }
        if (passed)
            for (int i = 0; i < LANES; i++)
                if (side[i] * next.s[PSI][i] >= check && count[i] < most) {
                    if (!located) {
                        side[i] = -side[i];
                        switches[i * most + count[i]++] = (n + 1) * dt;
                        continue;
                    }
                    State s = state_of(now, i);
                    REAL to = switching_step(boat_of(boats, i), &s, &side[i], angle, check, dt);
                    switches[i * most + count[i]++] = n * dt + to;
                    keep(&next, i, s);
                }
        *now = next;
    }
}

/* parameters: [PARAMETERS][boats], boats a multiple of LANES; located: whether switches are;
 * final: [STATES][boats]; switches: [boats][most], s, untouched where there is none. */
void zigzags(const REAL *parameters, long boats, int located, long steps, REAL dt, REAL angle,
             REAL check, long most, REAL *final, REAL *switches)
{
#pragma omp parallel for schedule(dynamic)
    for (long first = 0; first < boats; first += LANES) {
        Boats some;
        States now;
        for (int j = 0; j < PARAMETERS; j++)
            for (int i = 0; i < LANES; i++) some.p[j][i] = parameters[j * boats + first + i];
        for (int i = 0; i < LANES; i++) {
            some.p[M11][i] = some.p[M][i] - some.p[X_UDOT][i];
            some.p[M22][i] = some.p[M][i] - some.p[Y_VDOT][i];
            some.p[PER_M11][i] = 1 / some.p[M11][i];
            some.p[PER_M22][i] = 1 / some.p[M22][i];
            some.p[PER_M33][i] = 1 / (some.p[I_Z][i] - some.p[N_RDOT][i]);
        }
        memset(&now, 0, sizeof now);
        for (int i = 0; i < LANES; i++) {
            now.s[U][i] = some.p[SPEED][i];
            now.s[PORT][i] = now.s[STARBOARD][i] = some.p[THRUST][i];
        }
        block(&some, located, steps, dt, angle, check, most, &now, switches + first * most);
        for (int j = 0; j < STATES; j++)
            for (int i = 0; i < LANES; i++) final[j * boats + first + i] = now.s[j][i];
    }
}

/* Multiply-adds that do not wait for one another: the peak of one core, in operations. */
double multiply_adds(long count)
{
    REAL x[128];
    for (int i = 0; i < 128; i++) x[i] = (REAL)i;
    for (long n = 0; n < count; n++)
        for (int i = 0; i < 128; i++) x[i] = x[i] * (REAL)0.999 + (REAL)0.5;
    double sum = 0;
    for (int i = 0; i < 128; i++) sum += x[i];
    return sum;
}
