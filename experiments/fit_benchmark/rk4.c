/* The equations of plain.py, one run of one craft; states are written row by row. */

#include <math.h>

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
