"""A boat with one vectored thruster: its published runs, and its design by derivative."""

from experiments.harness.reporting import Experiment, compared, comparison, experiment, table
from experiments.pytheas import (
    design,
    disturbances,
    figures,
    hull_size,
    layouts,
    motor_out,
    requirements,
    still_water,
    sweep,
)

import numpy as np


SWELL = 20.0  # N, B of D2, D5 and D8
LONGER = (10.0, 20.0, 30.0)  # N, all of Table IV


def main() -> None:
    """Published runs first, then the design."""
    work = experiment(__file__, __doc__)
    calm, rows, tables = in_still_water(work)
    trials, more, text = in_swell(work)
    rows, tables = rows + more, tables | {"battery": text}
    others, more, text = other_layouts(work)
    rows, tables = rows + more, tables | {"layouts": text}
    asked, more, texts = required(work, calm["half_widths"])
    rows, tables = rows + more, tables | texts
    designs, more_tables = designed(work)
    tables |= more_tables
    maps, text = mapped(work)
    tables |= {"map": text}
    results = {
        "comparison": rows, "still_water": calm, "battery": trials, "layouts": others,
        "requirements": asked, "beyond": {"design": designs, "sweep": maps},
    }  # fmt: skip
    work.write(results, {"comparison": comparison(rows)} | tables)


def in_still_water(work: Experiment) -> tuple[dict, list[dict], dict[str, str]]:
    """Table III and figures 5 and 6."""
    eight = still_water.eight_waypoints()
    turns = still_water.tightest_turns()
    names = list(still_water.READINGS)[: 1 if work.quick else None]
    found = {"ahead": still_water.acceleration(names, 0.4)}
    if not work.quick:
        found["aft"] = still_water.acceleration(names, -0.4)
    taken = found["ahead"][names[0]]
    levers = {"ahead": 0.4} if work.quick else {"ahead": 0.4, "aft": -0.4}
    reached = {
        f"{name}, {place}": disturbances.reached(still_water.READINGS[name], lever)
        for name in names
        for place, lever in levers.items()
    }
    rotated = still_water.rotated_acceleration()
    found["ahead, positions turned by the heading"] = {names[0]: rotated}
    arrived = sum(track.t[-1] < 119.0 for track in eight)
    speed = float(eight[3].u.max())
    rows = [
        compared("top speed", "m/s", 1.4, speed, "at 20 N; its limit is thrust by drag"),
        compared("waypoints reached in still water", "of 8", 8, arrived),
        *still_water.table_three(taken),
        *still_water.turning_rows(turns),
    ]
    results = {
        "literal_1.4_m_s": still_water.literal_reading(eight[3]),
        "readings": found,
        "reached_by_reading": reached,
        "half_widths": {F: still_water.turning_radius(track) for F, track in turns.items()},
        "steady_radius_at_1_N": still_water.steady_radius(1.0),
        "half_width_of_turns_with_positions_turned": still_water.rotated_widths(work.quick),
    }
    work.save(figures.still_water(eight, turns), "still_water")
    work.say("still water")
    return results, rows, {"readings": still_water.readings_table(found, reached)}


def in_swell(work: Experiment) -> tuple[list[dict], list[dict], str]:
    """The battery D1 to D9, three ways."""
    tracks = disturbances.fly()
    ways = [
        {name: disturbances.printed_run(name, rotated) for name in disturbances.NAMES}
        for rotated in (False, True)
    ]
    trials, text = disturbances.summary(tracks, *ways)
    work.save(figures.battery(tracks, ways[1]), "disturbances")
    work.save(figures.trials(tracks), "trials")
    work.say("disturbances")
    return trials, disturbances.comparison_rows(trials), text


def other_layouts(work: Experiment) -> tuple[dict, list[dict], str]:
    """Figure 12."""
    makes = layouts.layouts()
    chosen = list(makes)[:2] if work.quick else list(makes)
    found = {name: layouts.flown(*makes[name]) for name in chosen}
    if not work.quick:
        work.save(figures.layouts(found), "layouts")
    work.say("layouts")
    return layouts.record(found), layouts.comparison_rows(found), layouts.layouts_table(found)


def required(work: Experiment, widths: dict[float, float]) -> tuple[dict, list[dict], dict]:
    """What the closed loop asks of thrust angle, tolerance, logic and thrust; a motor out."""
    every = 30.0 if work.quick else 5.0
    angles, sizes = requirements.angle_range(every), requirements.tolerances(every)
    near, compromise = requirements.nears(3 * every), requirements.thrusts(widths)
    sizes_of_hulls = hull_size.loaded(every)
    rows = requirements.comparison_rows(angles, near, compromise)
    results = {"thrust_angle": angles, "tolerance": sizes, "near": near, "thrust": compromise,
               "hull_size": sizes_of_hulls}  # fmt: skip
    texts = {
        "angles": requirements.angle_table(angles),
        "tolerances": requirements.shares_table("tolerance", sizes),
        "nears": requirements.shares_table("within", near),
        "thrusts": requirements.thrusts_table(compromise),
        "hulls": hull_size.hull_table(sizes_of_hulls),
    }
    work.save(figures.requirements(angles, near, requirements.NEARS), "requirements")
    work.say("requirements")
    if not work.quick:
        limping = motor_out.limping()
        rows.append(motor_out.comparison_row(limping))
        results["motor_out"] = motor_out.record(limping)
        texts["motor_out"] = motor_out.limping_table(limping)
        work.say("a motor out")
    return results, rows, texts


def designed(work: Experiment) -> tuple[dict, dict[str, str]]:
    """Least thrust and the thruster's place."""
    coarse, fine, finest = (9, 19, 19) if work.quick else (31, 361, 1801)
    check = design.gradient_check(SWELL, np.linspace(0.0, np.pi, coarse))
    found, lines = [], []
    for bias in (SWELL,) if work.quick else LONGER:
        for side in (1,) if work.quick else (1, -1):
            best = design.least(bias, side, coarse, fine)
            safe = design.rounded(best, finest)
            closed = design.head_sea_thrust(bias)
            found.append(best._asdict() | {"rounded": safe, "head_sea_thrust": closed})
            lines.append(design.row(best, safe, closed))
            work.say(f"design for {bias:.0f} N, side {side}")
    results = {"gradient_check": check, "designs": found}
    tables = {"designs": table(design.HEAD, lines)}
    if not work.quick:
        work.save(design_figure(found, fine), "design")
        names = list(still_water.READINGS)[:4]
        readings = {name: still_water.READINGS[name] for name in names}
        levers = design.shortest_levers(SWELL, 24.2, readings, 37)
        results["shortest_levers_by_D"] = levers
        rows = [
            (f"{n}: {readings[n]:.3f} m", one["ahead"], one["aft"]) for n, one in levers.items()
        ]
        tables["levers"] = table(("D", "lever ahead, m", "lever aft, m"), rows)
    return results, tables


def design_figure(found: list[dict], fine: int):
    """The margin's landscape and the two optima in it."""
    thrusts, levers = np.linspace(18.0, 30.0, 25), np.linspace(-0.5, 0.5, 41)
    least = design.landscape(SWELL, thrusts, levers, 31)
    directions = np.linspace(0.0, np.pi, fine)
    best = [one for one in found if one["bias"] == SWELL]
    places = {
        f"{one['thrust']:.2f} N, {abs(one['lever']):.3f} m "
        f"{'ahead' if one['lever'] > 0 else 'aft'}": (one["thrust"], one["lever"])
        for one in best
    }
    at_best = {
        name: design.margins(np.array(place), SWELL, directions, None)
        for name, place in places.items()
    }
    return figures.design(
        thrusts, levers, least, directions, at_best, list(places.values()), (20.0, 0.4)
    )


def mapped(work: Experiment) -> tuple[dict, str]:
    """10^5 designs of thrust and mass in two directions of the swell."""
    count = 24 if work.quick else 320
    directions = {"45 deg": np.pi / 4, "135 deg": 3 * np.pi / 4}
    maps = {name: sweep.sweep(count, SWELL, angle) for name, angle in directions.items()}
    slower = np.maximum(*(found.time for found in maps.values()))
    work.save(figures.sweep(maps), "sweep")
    work.say("sweep")
    return sweep.record(maps, slower), sweep.summary(maps, slower)


if __name__ == "__main__":
    main()
