"""Planar simulator of a 54 m training ship leaving a quay: whole-hull polynomial, thruster-hull
and wall interaction, delayed actuators, tide and wind.

Axes: x north, y east (m), psi clockwise from north (rad), u ahead, v to starboard (m/s, over
ground), r clockwise (rad/s). Forces in N, moments in N m about midships, positive ahead, to
starboard, clockwise. The quay is a vertical wall along north, on the east side, that ends.
Hull coefficients are non-dimensional with 0.5 rho L^2 U^2 (forces) and 0.5 rho L^3 U^2 (moments),
where U is a speed made of u, v and r together, so that v' = v/U and r' = L r/U stay bounded and
the polynomial holds at rest, sideways and astern.
"""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


RHO_WATER = 1025.0  # kg/m^3
RHO_AIR = 1.225  # kg/m^3
YAW_ARM = 0.4  # part of L r that counts in the reference speed U
TINY = 1e-9  # keeps divisions finite at rest
REGISTER = 24  # length of the register of past orders, in control periods
SUBSTEPS = 2  # Runge-Kutta steps in one control period
BOW_FENDER, STERN_FENDER = 0.3, -0.3  # where fenders touch, in lengths from midships
DEG = math.pi / 180.0

Number = Float[Array, ""]
Pair = Float[Array, "2"]  # (bow thruster, stern thruster)


def number(value, spread=0.15):
    """A field with its nominal value and its log-normal spread between drawn ships."""
    return eqx.field(default=value, converter=jnp.asarray, metadata={"spread": spread})


class PolynomialShip(eqx.Module):
    """All constants of one ship and her berth; primed (non-dimensional) unless a unit is given."""

    # Main dimensions and berth.
    length: Number = number(54.0, 0.0)  # m
    beam: Number = number(11.10, 0.0)  # m
    draught: Number = number(3.33, 0.0)  # m
    mass: Number = number(1.125e6, 0.0)  # kg
    inertia: Number = number(2.05e8, 0.0)  # kg m^2, radius of gyration L/4
    x_g: Number = number(-0.5, 0.0)  # m, centre of gravity a little aft of midships
    depth: Number = number(6.0, 0.1)  # m of water, harbour basin
    wall_y: Number = number(12.0, 0.0)  # m, east of the starting centreline
    wall_end: Number = number(250.0, 0.0)  # m, north of the start: there the quay ends
    # Added inertia in deep water: Clarke et al. (1983) for these proportions, C_b 0.55.
    X_udot: Number = number(-0.0007, 0.1)  # 5 % of the mass, Fossen
    Y_vdot: Number = number(-0.0129, 0.1)
    Y_rdot: Number = number(-0.0012, 0.1)  # N_vdot is taken to be the same
    N_rdot: Number = number(-0.00056, 0.1)
    added_depth: Number = number(1.5)  # growth times (T/h)^2: half as much again at h/T 1.8
    # Surge: friction line, 636 m^2 wetted, form and roughness (C_T 0.0043 at 8 kn).
    R_u: Number = number(350.0)  # N/(m/s)
    R_uu: Number = number(1150.0, 0.1)  # N/(m/s)^2
    R_uuu: Number = number(42.0)  # N/(m/s)^3, wave making
    X_vr: Number = number(0.0064, 0.1)  # half of the sway added mass
    X_uvv: Number = number(-0.006)  # order of the Mariner's X_vv (Chislett & Stroem-Tejsen 1965)
    X_urr: Number = number(-0.0008)  # small induced drag of turning, same source
    # Sway: linear terms Clarke; cubic ones as the Mariner's, scaled by draught over length.
    Y_v: Number = number(-0.0207, 0.1)
    Y_r: Number = number(0.0038)
    Y_vabs: Number = number(-0.030)  # with Y_vvv gives a beam drag coefficient of 0.9
    Y_vvv: Number = number(-0.026)
    Y_vrr: Number = number(-0.005)  # a twelfth of the beam drag
    Y_vvr: Number = number(0.012)  # sign of the Mariner's, a tenth of it: shallow draught
    Y_rrr: Number = number(0.0003)
    # Yaw: the same sources.
    N_v: Number = number(-0.0077, 0.1)
    N_r: Number = number(-0.0032, 0.1)
    N_vabs: Number = number(0.0006)  # lateral area lies 1 % of L aft of midships
    N_vvv: Number = number(0.003)
    N_vrr: Number = number(-0.001)
    N_rvabs: Number = number(-0.005)  # with N_vvr a sixth of the beam drag
    N_vvr: Number = number(-0.005)
    N_rrr: Number = number(-0.0008)  # turning on the spot: beam drag over 32
    lift_depth: Number = number(0.6)  # growth of the linear terms times (T/h)^2, Ankudinov
    cross_depth: Number = number(2.9)  # growth of the cross-flow terms times (T/h)^2
    build_up: Number = number(0.3)  # part of the cross-flow drag that needs time to build up
    build_time: Number = number(10.0)  # s
    # Asymmetry of a single screw: order of the Mariner's Y_0 and N_0.
    Y_0: Number = number(-4e-5)
    N_0: Number = number(3e-5)
    # Controllable-pitch propeller of 2.3 m at 5 turns a second, thrust linear in angle and speed.
    T_a: Number = number(6.0e5, 0.1)  # N/rad
    T_aa: Number = number(2.0e5)  # N/rad^2
    T_u: Number = number(18.5e3, 0.1)  # N/(m/s) of inflow
    pitch_zero: Number = number(-1.5 * DEG, 0.1)  # rad, angle of no thrust at rest
    astern_loss: Number = number(0.2)  # astern thrust is that much weaker
    deduction: Number = number(0.2, 0.1)
    wake: Number = number(0.2, 0.1)
    disc: Number = number(4.15, 0.0)  # m^2
    walk_churn: Number = number(300.0)  # N, stern to starboard at constant turns, no pitch
    walk_astern: Number = number(0.10)  # part of the astern thrust that goes to starboard
    walk_fade: Number = number(1.5)  # m/s, speed at which half of the walk is left
    x_screw: Number = number(-25.0, 0.0)  # m
    # Rudder: 5 m^2 of aspect ratio 1.5; polynomial in its inflow angle, on the race's pressure.
    Y_d: Number = number(-0.0047, 0.1)
    Y_ddd: Number = number(0.0043, 0.1)
    N_d: Number = number(0.0026, 0.1)  # lever of 0.55 L: carry-over on the stern
    N_ddd: Number = number(-0.0024, 0.1)
    X_dd: Number = number(-0.0026)
    race_share: Number = number(0.65)  # part of the rudder in the race
    straighten: Number = number(0.45)  # part of the drift angle that the rudder feels
    swirl: Number = number(0.025)  # rad, turn of the race by the screw
    x_rudder: Number = number(-27.0, 0.0)  # m
    # Tunnel thrusters (bow, stern): 30 kN at 11 and 9 degrees, part linear and part quadratic.
    F_a: Pair = number((93.8e3, 114.6e3), 0.1)  # N/rad
    F_aa: Pair = number((325.5e3, 486.0e3), 0.1)  # N/rad^2
    port_loss: Pair = number((0.05, -0.04))  # weaker (stronger) to port
    x_tunnel: Pair = number((21.0, -18.0), 0.0)  # m
    tunnel_area: Number = number(0.8, 0.0)  # m^2
    jet_rest: Number = number(2.0)  # m/s, jet speed that remains at zero blade angle
    # Loss with speed over jet speed: dip near ratio `dip_at`, then partial recovery (Chislett &
    # Bjoerheden 1966, Brix 1993); the moment keeps more at the bow and less at the stern.
    dip_at: Pair = number((0.28, 0.35), 0.1)
    dip_force: Pair = number((0.45, 0.22), 0.2)
    dip_moment: Pair = number((0.30, 0.28), 0.2)
    fade_force: Pair = number((0.15, 0.20), 0.2)
    fade_moment: Pair = number((0.12, 0.24), 0.2)
    other_way: Pair = number((0.5, -0.4))  # change of the loss from ahead to astern
    flap_gain: Pair = number((0.05, 0.45), 0.2)  # jet flap times (T/h)^2, Fujino et al. 1978
    advance_loss: Pair = number((1.4, 1.1), 0.2)  # loss when she moves the way the thruster pushes
    drift_loss: Pair = number((0.8, 1.0), 0.2)  # loss when she drifts into the jet
    jet_wall: Pair = number((0.20, 0.26), 0.2)  # loss when the jet hits the wall
    intake_wall: Pair = number((0.08, 0.06), 0.2)  # loss when the intake faces the wall
    pair_wall: Number = number(0.18, 0.2)  # further loss of both pushing the same way near the wall
    # Wall: Norrbin's form, fading with clear distance.
    wall_reach: Number = number(11.0, 0.1)  # m, one beam
    wall_suction: Number = number(0.0018, 0.2)
    wall_bow_out: Number = number(0.00037, 0.2)
    wall_drag: Number = number(0.8, 0.2)  # growth of the cross-flow terms
    wall_added: Number = number(0.5, 0.2)  # growth of the added mass
    fender: Number = number(2.0e5, 0.0)  # N/m at each of two points
    fender_damp: Number = number(2.0e5, 0.0)  # N/(m/s) per metre pressed in
    # Wind: Fourier series in the angle off the bow; areas of a small ship with a deckhouse.
    front_area: Number = number(85.0, 0.0)  # m^2
    side_area: Number = number(330.0, 0.0)  # m^2
    wind_x: Float[Array, "3"] = number((-0.05, 0.60, 0.10))  # constant, cos, cos 3
    wind_y: Float[Array, "2"] = number((0.85, -0.06))  # sin, sin 3
    wind_n: Float[Array, "3"] = number((-0.02, 0.10, 0.015))  # sin, sin 2, sin 3
    # Actuators: rates and lags, then dead times.
    rudder_rate: Number = number(2.8 * DEG, 0.1)  # rad/s
    rudder_lag: Number = number(0.8)  # s
    pitch_rate: Number = number(0.8 * DEG, 0.1)  # rad/s
    pitch_lag: Number = number(1.5)  # s
    tunnel_rate: Pair = number((3.0 * DEG, 2.5 * DEG), 0.1)  # rad/s
    tunnel_lag: Pair = number((3.6, 4.6))  # s
    tunnel_dead: Pair = number((4.4, 3.5), 0.1)  # s
    pitch_limit: Pair = number((-4.5 * DEG, 9.0 * DEG), 0.0)  # rad
    rudder_limit: Number = number(35.0 * DEG, 0.0)  # rad
    tunnel_limit: Pair = number((15.0 * DEG, 13.0 * DEG), 0.0)  # rad


class Afloat(eqx.Module):
    """The state of the ship: position, velocity over ground, actuators, lagged flow, orders."""

    x: Number  # m
    y: Number  # m
    psi: Number  # rad
    u: Number  # m/s
    v: Number  # m/s
    r: Number  # rad/s
    rudder: Number  # rad
    pitch: Number  # rad
    tunnel: Pair  # rad, blade angles in effect
    crossflow: Number  # m/s, sway velocity that the flow about the hull has caught up with
    queue: Float[Array, "periods 2"]  # rad, past tunnel orders, the newest first


def drawn(seed: int) -> PolynomialShip:
    """The nominal ship for seed 0, otherwise one with each coefficient off by its own spread."""
    ship = PolynomialShip()
    if seed == 0:
        return ship
    rng = np.random.default_rng([seed, 11])
    off = {}
    for field in dataclasses.fields(PolynomialShip):
        value = np.asarray(getattr(ship, field.name), float)
        normal = np.clip(rng.standard_normal(value.shape), -2.5, 2.5)
        off[field.name] = jnp.asarray(value * np.exp(field.metadata["spread"] * normal))
    return PolynomialShip(**off)


def at(ship: PolynomialShip, x, y, psi, u) -> Afloat:
    """The ship at a place with u ahead; blades set to hold that speed in still water."""
    zero = jnp.zeros_like(ship.length)
    thrust = resistance(ship, u) / (1.0 - ship.deduction) + ship.T_u * (1.0 - ship.wake) * u
    root = jnp.sqrt(ship.T_a**2 + 4.0 * ship.T_aa * jnp.abs(thrust))
    angle = jnp.sign(thrust) * (root - ship.T_a) / (2.0 * ship.T_aa)
    pitch = jnp.clip(angle + ship.pitch_zero, ship.pitch_limit[0], ship.pitch_limit[1])
    queue = jnp.zeros((REGISTER, 2), zero.dtype)
    place = (zero + x, zero + y, zero + psi, zero + u)
    return Afloat(*place, zero, zero, zero, pitch, queue[0], zero, queue)


def advanced(
    ship: PolynomialShip,
    afloat: Afloat,
    blades,
    current_north,
    current_east,
    wind_north,
    wind_east,
    dt,
) -> Afloat:
    """The state one control period of dt seconds later; the same dt is meant at every call."""
    propeller, rudder, tunnels = limited(ship, blades)
    queue = jnp.concatenate([tunnels[None], afloat.queue[:-1]])
    afloat = dataclasses.replace(afloat, queue=queue)
    orders = (propeller, rudder, delayed(ship, queue, dt))
    step = dt / SUBSTEPS

    def rate(state):
        tide, wind = (current_north, current_east), (wind_north, wind_east)
        return derivative(ship, state, orders, tide, wind)

    def moved(state, slope, time):
        return jax.tree_util.tree_map(lambda value, change: value + time * change, state, slope)

    def runge_kutta(_, state):
        first = rate(state)
        second = rate(moved(state, first, step / 2.0))
        third = rate(moved(state, second, step / 2.0))
        fourth = rate(moved(state, third, step))
        for slope, weight in ((first, 1), (second, 2), (third, 2), (fourth, 1)):
            state = moved(state, slope, step * weight / 6.0)
        return state

    return jax.lax.fori_loop(0, SUBSTEPS, runge_kutta, afloat)


def thrusters_side_force(ship: PolynomialShip, afloat: Afloat, blades) -> Number:
    """Side force (N, to starboard) of the ordered tunnel blade angles once in effect, at the
    present velocity, without wall."""
    _, _, tunnels = limited(ship, blades)
    away = jnp.zeros_like(tunnels)
    return thruster_forces(ship, tunnels, afloat.u, afloat.v, afloat.r, away, 1.0)[1]


def limited(ship, blades):
    """The orders within what the gear can do: propeller, rudder, pair of tunnel angles (rad)."""
    propeller, rudder, bow, stern = blades
    propeller = jnp.clip(propeller, ship.pitch_limit[0], ship.pitch_limit[1])
    rudder = jnp.clip(rudder, -ship.rudder_limit, ship.rudder_limit)
    return (
        propeller,
        rudder,
        jnp.clip(jnp.stack([bow, stern]), -ship.tunnel_limit, ship.tunnel_limit),
    )


def delayed(ship, queue, dt):
    """The tunnel orders of one dead time ago, between two entries of the register."""
    back = jnp.clip(ship.tunnel_dead / dt, 0.0, REGISTER - 1.0)
    places = jnp.arange(float(REGISTER))
    return jnp.stack([jnp.interp(back[i], places, queue[:, i]) for i in range(2)])


def derivative(ship, s, orders, tide, wind) -> Afloat:
    """Rate of change of every part of the state."""
    cos, sin = jnp.cos(s.psi), jnp.sin(s.psi)
    u_tide, v_tide = tide[0] * cos + tide[1] * sin, tide[1] * cos - tide[0] * sin
    u, v = s.u - u_tide, s.v - v_tide
    north, east = s.u * cos - s.v * sin, s.u * sin + s.v * cos
    near = closeness(ship, s, 0.0)
    near_tunnels = closeness(ship, s, ship.x_tunnel)
    parts = (
        hull_forces(ship, u, v, s.r, s.crossflow, near),
        screw_and_rudder_forces(ship, u, v, s.r, s.pitch, s.rudder),
        thruster_forces(ship, s.tunnel, u, v, s.r, near_tunnels, cos),
        wall_forces(ship, s, u, near, cos, sin),
        wind_forces(ship, wind[0] * cos + wind[1] * sin - s.u, wind[1] * cos - wind[0] * sin - s.v),
    )
    total = [sum(part[i] for part in parts) for i in range(3)]
    u_dot, v_dot, r_dot = accelerations(ship, total, u, v, s.r, near, east)
    propeller, rudder, tunnels = orders
    return Afloat(
        x=north,
        y=east,
        psi=s.r,
        # A uniform tide turns in the ship's axes as she turns.
        u=u_dot + s.r * v_tide,
        v=v_dot - s.r * u_tide,
        r=r_dot,
        rudder=followed(s.rudder, rudder, ship.rudder_lag, ship.rudder_rate),
        pitch=followed(s.pitch, propeller, ship.pitch_lag, ship.pitch_rate),
        tunnel=followed(s.tunnel, tunnels, ship.tunnel_lag, ship.tunnel_rate),
        crossflow=(v - s.crossflow) / ship.build_time,
        queue=jnp.zeros_like(s.queue),
    )


def followed(value, order, lag, rate):
    """Rate of an actuator that follows its order with a lag (s) and a greatest rate."""
    return jnp.clip((order - value) / lag, -rate, rate)


def gap(ship, s, station):
    """Clear distance (m) from the hull's side at a station (m from midships) to the wall, and
    from its end the way made good beyond that."""
    half = 0.5 * ship.beam * jnp.abs(jnp.cos(s.psi))
    beyond = jnp.maximum(s.x + station * jnp.cos(s.psi) - ship.wall_end, 0.0)
    return ship.wall_y - s.y - station * jnp.sin(s.psi) - half + beyond


def closeness(ship, s, station):
    """1 at the wall, towards 0 far from it."""
    return jnp.exp(-jnp.maximum(gap(ship, s, station), 0.0) / ship.wall_reach)


def shallowness(ship):
    """(T/h)^2, by which shallow-water growth is scaled."""
    return (ship.draught / ship.depth) ** 2


def resistance(ship, u):
    """Resistance (N) at steady speed u ahead; odd in u."""
    return ship.R_u * u + ship.R_uu * u * jnp.abs(u) + ship.R_uuu * u**3


def hull_forces(ship, u, v, r, crossflow, near):
    """Polynomial of the whole hull in velocities through the water."""
    length = ship.length
    speed = jnp.sqrt(u**2 + v**2 + (YAW_ARM * length * r) ** 2 + TINY)
    pressure = 0.5 * RHO_WATER * length**2 * speed**2
    up, vp, rp = u / speed, v / speed, length * r / speed
    lift = 1.0 + ship.lift_depth * shallowness(ship)
    agreement = 2.0 * v * crossflow / (v**2 + crossflow**2 + TINY)  # 1 once flow has built up
    cross = (1.0 + ship.cross_depth * shallowness(ship)) * (1.0 + ship.wall_drag * near)
    cross = cross * (1.0 - ship.build_up * (1.0 - agreement))
    x_force = ship.X_vr * vp * rp + up * (ship.X_uvv * vp**2 + ship.X_urr * rp**2)
    y_lift = ship.Y_v * jnp.abs(up) * vp + ship.Y_r * up * rp
    y_lift = y_lift + up * (ship.Y_vvr * vp**2 * rp + ship.Y_rrr * rp**3) + ship.Y_0 * up**2
    y_cross = ship.Y_vabs * vp * jnp.abs(vp) + ship.Y_vvv * vp**3 + ship.Y_vrr * vp * rp**2
    n_lift = ship.N_v * up * vp + ship.N_r * jnp.abs(up) * rp
    n_lift = n_lift + up * (ship.N_vvv * vp**3 + ship.N_vrr * vp * rp**2) + ship.N_0 * up**2
    n_cross = ship.N_vabs * vp * jnp.abs(vp) + ship.N_rvabs * rp * jnp.abs(vp)
    n_cross = n_cross + ship.N_vvr * vp**2 * rp + ship.N_rrr * rp**3
    return (
        pressure * x_force - resistance(ship, u),
        pressure * (lift * y_lift + cross * y_cross),
        pressure * length * (lift * n_lift + cross * n_cross),
    )


def screw_and_rudder_forces(ship, u, v, r, pitch, rudder):
    """Propeller thrust and walk, and the rudder in the race."""
    inflow = (1.0 - ship.wake) * u
    angle = pitch - ship.pitch_zero
    thrust = ship.T_a * angle + ship.T_aa * angle * jnp.abs(angle) - ship.T_u * inflow
    ahead, astern = jnp.maximum(thrust, 0.0), jnp.maximum(-thrust, 0.0)
    astern = astern * (1.0 - ship.astern_loss)
    walk = (ship.walk_churn + ship.walk_astern * astern) / (1.0 + (u / ship.walk_fade) ** 2)
    added = 2.0 * ahead / (RHO_WATER * ship.disc)  # (m/s)^2 given to the race
    square = inflow * jnp.abs(inflow) + ship.race_share * added
    size = jnp.abs(square)
    across = (v + ship.x_rudder * r) / jnp.sqrt(size + 0.1)
    turn = ship.swirl * added / (added + inflow**2 + 0.1)
    alpha = square / (size + 0.01) * rudder + turn
    alpha = jnp.clip(alpha + ship.straighten * jnp.clip(across, -1.0, 1.0), -0.6, 0.6)
    pressure = 0.5 * RHO_WATER * ship.length**2 * size
    y_rudder = pressure * (ship.Y_d * alpha + ship.Y_ddd * alpha**3)
    n_rudder = pressure * ship.length * (ship.N_d * alpha + ship.N_ddd * alpha**3)
    x_rudder = 0.5 * RHO_WATER * ship.length**2 * square * ship.X_dd * alpha**2
    x_force = (1.0 - ship.deduction) * ahead - astern + x_rudder
    return x_force, walk + y_rudder, ship.x_screw * walk + n_rudder


def thruster_forces(ship, tunnel, u, v, r, near, cos_psi):
    """Tunnel thrusters with the hull's answer to their jets; near: closeness of the wall."""
    free = ship.F_a * tunnel + ship.F_aa * tunnel * jnp.abs(tunnel)
    free = free * (1.0 - ship.port_loss * (tunnel < 0.0))
    side = jnp.tanh(free / 2000.0)  # which way each one pushes
    jet = jnp.sqrt(jnp.abs(free) / (RHO_WATER * ship.tunnel_area) + ship.jet_rest**2)
    # Ahead or astern speed bends the jet along the hull, which sucks the hull back.
    ratio = jnp.abs(u) / (jet * ship.dip_at)
    dip, fade = 2.0 * ratio**2 / (1.0 + ratio**4), ratio**2 / (1.0 + ratio**2)
    course = 1.0 - ship.other_way * jnp.maximum(-jnp.tanh(u / 0.3), 0.0)
    flap = ship.flap_gain * shallowness(ship) * fade
    force_left = 1.0 - course * (ship.dip_force * dip + ship.fade_force * fade) + flap
    moment_left = 1.0 - course * (ship.dip_moment * dip + ship.fade_moment * fade) + flap
    # Sideways motion at the tunnel, positive when she moves the way it pushes.
    moving = side * (v + ship.x_tunnel * r) / jet
    drift = 1.0 - ship.advance_loss * jnp.maximum(moving, 0.0)
    drift = jnp.clip(drift - ship.drift_loss * jnp.maximum(-moving, 0.0), 0.3, 1.0)
    # The wall: a jet thrown at it comes back along the hull, and spoils its neighbour too.
    at_wall = -side * cos_psi
    loss = ship.jet_wall * jnp.maximum(at_wall, 0.0)
    loss = loss + ship.intake_wall * jnp.maximum(-at_wall, 0.0)
    loss = near * (loss + ship.pair_wall * jnp.maximum(side[0] * side[1], 0.0))
    force = free * drift * jnp.maximum(force_left, 0.1) * (1.0 - loss)
    moment = free * drift * jnp.maximum(moment_left, 0.1) * (1.0 - 0.6 * loss)
    return 0.0, jnp.sum(force), jnp.sum(ship.x_tunnel * moment)


def wall_forces(ship, s, u, near, cos, sin):
    """Suction and bow-out moment of the wall with ahead speed, and two soft fenders."""
    pressure = 0.5 * RHO_WATER * ship.length**2 * u**2 * near
    east = pressure * ship.wall_suction * cos**2
    moment = -pressure * ship.length * ship.wall_bow_out * cos * jnp.tanh(u / 0.3)
    for part in (BOW_FENDER, STERN_FENDER):
        station = part * ship.length
        pressed = jnp.clip(-gap(ship, s, station), 0.0, 2.0)
        inward = s.u * sin + (s.v + station * s.r) * cos
        push = pressed * jnp.maximum(ship.fender + ship.fender_damp * inward, 0.0)
        east, moment = east - push, moment - push * cos * station
    return east * sin, east * cos, moment


def wind_forces(ship, u_air, v_air):
    """Wind on the upper works; u_air, v_air: air's motion past the ship in her axes (m/s)."""
    square = u_air**2 + v_air**2
    speed = jnp.sqrt(square + TINY)
    c, s = -u_air / speed, -v_air / speed  # of the angle off the bow that it comes from
    c_3, s_2, s_3 = 4.0 * c**3 - 3.0 * c, 2.0 * s * c, 3.0 * s - 4.0 * s**3
    pressure = 0.5 * RHO_AIR * square
    c_x = ship.wind_x[0] + ship.wind_x[1] * c + ship.wind_x[2] * c_3
    c_y = ship.wind_y[0] * s + ship.wind_y[1] * s_3
    c_n = ship.wind_n[0] * s + ship.wind_n[1] * s_2 + ship.wind_n[2] * s_3
    side = pressure * ship.side_area
    return -pressure * ship.front_area * c_x, -side * c_y, -side * ship.length * c_n


def accelerations(ship, total, u, v, r, near, east):
    """Accelerations through the water under the total force, by Newton's law about midships."""
    x_force, y_force, n_force = total
    unit = 0.5 * RHO_WATER * ship.length**3
    growth = 1.0 + ship.added_depth * shallowness(ship)
    # The water between hull and wall: more added mass, which changes as she comes or goes.
    swelling = near * (near < 1.0) * ship.wall_added * east / ship.wall_reach
    water = -unit * growth
    m_v, m_r = water * ship.Y_vdot, water * ship.length * ship.Y_rdot
    n_r = water * ship.length**2 * ship.N_rdot
    y_force = y_force - 0.5 * swelling * (m_v * v + m_r * r)
    n_force = n_force - 0.5 * swelling * (m_r * v + n_r * r)
    crowd = 1.0 + ship.wall_added * near
    first = ship.mass + crowd * m_v
    cross = ship.mass * ship.x_g + crowd * m_r
    last = ship.inertia + crowd * n_r
    y_left = y_force - ship.mass * u * r
    n_left = n_force - ship.mass * ship.x_g * u * r
    x_left = x_force + ship.mass * (v * r + ship.x_g * r**2)
    bottom = first * last - cross**2
    u_dot = x_left / (ship.mass - unit * ship.X_udot)
    v_dot = (last * y_left - cross * n_left) / bottom
    r_dot = (first * n_left - cross * y_left) / bottom
    return u_dot, v_dot, r_dot
