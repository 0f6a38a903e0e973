"""MATLAB functions that a vessel's function may need beside it, each by its name."""

SMALL = "1e-12"  # m^2/s^2, as in diffsea: keeps square roots and angles defined at rest

SUBFUNCTIONS = {
    "servo": """
function rate = servo(value, goal, T, slowness)
% Approach to a goal by a lag T (s), at most at the rate 1 / slowness.
rate = (goal - value) / T;
if slowness > 0, rate = max(min(rate, 1 / slowness), -1 / slowness); end
end""",
    "settled": """
function value = settled(order, bias, deadband, neutral, lower, upper)
% What an order settles to: bias, dead band about neutral, limits.
above = order + bias - neutral;
above = sign(above) * max(abs(above) - deadband, 0);
value = min(max(above + neutral, lower), upper);
end""",
    "push": """
function tau = push(thrust, x, y, angle)
% Force and moment of a thrust at (x, y), angle clockwise from ahead.
X = thrust * cos(angle);
Y = thrust * sin(angle);
tau = [X; Y; x * Y - y * X];
end""",
    "curve_thrust": """
function thrust = curve_thrust(order, ahead, astern, full, b, p, astern_ratio)
% Thrust (N) of an order above neutral by a thrust curve with dead band b and exponent p.
if order < 0, s = order / astern; else, s = order / ahead; end
s = min(max(s, -1), 1);
a = max(abs(s) - b, 0) / (1 - b);
thrust = full * a * max(a, 1e-6)^(p - 1);
if s < 0, thrust = -astern_ratio * thrust; end
end""",
    "strips": """
function tau = strips(v, r, half, unit)
% Cross-flow drag of strip theory in closed form, (Y, N) = unit * int (1, x) |v + x r| (v + x r) dx.
if abs(v) >= abs(r) * half
    s = 1; if v < 0, s = -1; end
    tau = unit * s * [0; 2 * half * v^2 + 2 / 3 * r^2 * half^3; 4 / 3 * v * r * half^3];
else
    a = v - r * half;
    b = v + r * half;
    cubes = (abs(b)^3 - abs(a)^3) / 3;
    fourths = (abs(b)^3 * b - abs(a)^3 * a) / 4;
    tau = unit * [0; cubes / r; (fourths - v * cubes) / r^2];
end
end""",
    "drift_speed": f"""
function speed = drift_speed(u, v)
% Drift angle times speed, m/s.
ahead = sqrt(u^2 + {SMALL});
speed = sqrt(ahead^2 + v^2) * atan2(-v, ahead);
end""",
    "open_water": f"""
function [square, advance] = open_water(n, u, v, r, x, D, k_T, wake, decay, astern)
% K_T n^2 (1/s^2), and the speed of the water into the disc (m/s).
drift = drift_speed(u, v) - x * r;
advance = (1 - wake * exp(-decay * drift^2 / (u^2 + v^2 + {SMALL}))) * u;
k0 = k_T(1);
if n < 0, k0 = k0 * astern; end
V = advance / D;
square = k0 * n * abs(n) + k_T(2) * abs(n) * V + k_T(3) * V * abs(V);
end""",
}
