/* The equations of plain.py, one run of one craft or of LANES of them side by side; states are
 * written row by row. */

#include <math.h>
#include <string.h>

static void rate(const double *s, double force, double moment, const double *c, double *out) {
    const double cosine = cos(s[2]), sine = sin(s[2]), u = s[3], v = s[4], r = s[5];
    out[0] = u * cosine - v * sine;
    out[1] = u * sine + v * cosine;
    out[2] = r;
    out[3] = (force + c[1] * v * r + (c[3] + c[4] * fabs(u)) * u) / c[0];
    out[4] = (c[5] * v - c[0] * u * r) / c[1];
    out[5] = (moment + (c[0] - c[1]) * u * v + (c[6] + c[7] * fabs(r)) * r) / c[2];
}

void simulate(int rows, double h, const double *force, const double *moment, const double *c,
              const double *first, double *out) {
    static const double reach[4] = {0.0, 0.5, 0.5, 1.0}, weight[4] = {1.0, 2.0, 2.0, 1.0};
    for (int i = 0; i < 6; i++) out[i] = first[i];
    for (int k = 0; k + 1 < rows; k++) {
        const double *s = out + 6 * k;
        double *next = out + 6 * (k + 1), slope[6] = {0}, at[6];
        for (int i = 0; i < 6; i++) next[i] = s[i];
        for (int stage = 0; stage < 4; stage++) {
            for (int i = 0; i < 6; i++) at[i] = s[i] + reach[stage] * h * slope[i];
            rate(at, force[k], moment[k], c, slope);
            for (int i = 0; i < 6; i++) next[i] += h / 6.0 * weight[stage] * slope[i];
        }
    }
}

enum { LANES = 16 };

static void lanes_rate(double s[6][LANES], double force, double moment, const double c[8][LANES],
                       double out[6][LANES]) {
#pragma omp simd
    for (int i = 0; i < LANES; i++) {
        const double cosine = cos(s[2][i]), sine = sin(s[2][i]);
        const double u = s[3][i], v = s[4][i], r = s[5][i];
        out[0][i] = u * cosine - v * sine;
        out[1][i] = u * sine + v * cosine;
        out[2][i] = r;
        out[3][i] = (force + c[1][i] * v * r + (c[3][i] + c[4][i] * fabs(u)) * u) / c[0][i];
        out[4][i] = (c[5][i] * v - c[0][i] * u * r) / c[1][i];
        out[5][i] = (moment + (c[0][i] - c[1][i]) * u * v + (c[6][i] + c[7][i] * fabs(r)) * r)
                    / c[2][i];
    }
}

/* Coefficients, first states and what is written have a lane as their last axis. */
void simulate_lanes(int rows, double h, const double *force, const double *moment,
                    const double c[8][LANES], const double first[6][LANES],
                    double out[][6][LANES]) {
    static const double reach[4] = {0.0, 0.5, 0.5, 1.0}, weight[4] = {1.0, 2.0, 2.0, 1.0};
    memcpy(out[0], first, sizeof out[0]);
    for (int k = 0; k + 1 < rows; k++) {
        double slope[6][LANES] = {{0}}, at[6][LANES], next[6][LANES];
        memcpy(next, out[k], sizeof next);
        for (int stage = 0; stage < 4; stage++) {
            for (int j = 0; j < 6; j++)
                for (int i = 0; i < LANES; i++)
                    at[j][i] = out[k][j][i] + reach[stage] * h * slope[j][i];
            lanes_rate(at, force[k], moment[k], c, slope);
            for (int j = 0; j < 6; j++)
                for (int i = 0; i < LANES; i++) next[j][i] += h / 6.0 * weight[stage] * slope[j][i];
        }
        memcpy(out[k + 1], next, sizeof next);
    }
}
