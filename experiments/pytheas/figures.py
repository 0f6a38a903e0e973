"""The experiment's figures."""

from experiments.harness.reporting import panels
from experiments.pytheas import disturbances
from experiments.pytheas.boat import FREQUENCY, SWING
from experiments.pytheas.layouts import Flown
from experiments.pytheas.sailing import Track
from experiments.pytheas.sweep import Map

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure


BLUE, RED, GREY, ORANGE = "#1f5fa8", "#b03a48", "#8a8a8a", "#d1720f"


def circle(ax: Axes, north: float, east: float, radius: float) -> None:
    """A waypoint's tolerance, east to the right."""
    angle = np.linspace(0, 2 * np.pi, 100)
    ax.plot(east + radius * np.sin(angle), north + radius * np.cos(angle), ":", color=GREY, lw=1)


def still_water(eight: list[Track], turns: dict[float, Track]) -> Figure:
    """Runs to eight waypoints, and the tightest turns."""
    figure, axes = panels(1, 2, 10.0, 4.8)
    left, right = axes[0]
    for track, bearing in zip(eight, np.deg2rad(np.arange(-135.0, 181.0, 45.0)), strict=True):
        left.plot(track.y, track.x, color=BLUE, lw=1.2)
        circle(left, 20 * np.cos(bearing), 20 * np.sin(bearing), 2.5)
    left.set(title="to eight waypoints, from rest heading north", aspect="equal")
    shades = np.linspace(0.3, 1.0, len(turns))
    for (thrust, track), shade in zip(turns.items(), shades, strict=True):
        right.plot(track.y, track.x, color=BLUE, alpha=shade, lw=1.2, label=f"{thrust:.0f} N")
    circle(right, -1.5, 0.0, 1.0)
    right.set(title="half turns to a waypoint astern", aspect="equal", xlim=(-0.3, 0.7),
              ylim=(-0.75, 0.15))  # fmt: skip
    right.legend(frameon=False, fontsize=8, title="full thrust", title_fontsize=8)
    for ax in (left, right):
        ax.set(xlabel="east, m", ylabel="north, m")
    return figure


def battery(tracks: dict[str, Track], rotated: dict[str, np.ndarray]) -> Figure:
    """D1 to D9: obtained, and with positions turned by the heading."""
    figure, axes = panels(3, 3, 8.0, 6.8)
    for k, (name, track) in enumerate(tracks.items()):
        ax = axes.flat[k]
        ax.plot(track.y, track.x, color=BLUE, lw=1.2, label="obtained")
        ax.plot(rotated[name][:, 2], rotated[name][:, 1], color=ORANGE, lw=1, ls="--",
                label="positions turned by the heading")  # fmt: skip
        circle(ax, 20.0, 0.0, 2.5)
        bias, direction = disturbances.BIASES[k % 3], disturbances.DIRECTIONS[k // 3]
        ax.annotate("", (-6 + 6 * np.sin(direction), 12 + 6 * np.cos(direction)), (-6, 12),
                    arrowprops={"arrowstyle": "->", "color": RED})  # fmt: skip
        ax.set(title=f"{name}: {bias:.0f} N, published: {disturbances.PUBLISHED[k]}",
               xlim=(-12, 28), ylim=(-8, 26), aspect="equal")  # fmt: skip
        ax.title.set_fontsize(9)
    for ax in axes[-1]:
        ax.set_xlabel("east, m")
    for ax in axes[:, 0]:
        ax.set_ylabel("north, m")
    axes[0, 0].legend(frameon=False, fontsize=7, loc="lower right")
    return figure


def layouts(found: dict[str, Flown]) -> Figure:
    """Tracks and headings to the waypoint astern."""
    figure, axes = panels(1, 2, 10.0, 4.0)
    colours = (BLUE, RED, ORANGE, GREY)
    for (name, one), colour in zip(found.items(), colours, strict=True):
        track = one.tracks[-1]
        axes[0, 0].plot(track.y, track.x, color=colour, lw=1.3, label=name)
        axes[0, 1].plot(track.t, np.rad2deg(track.psi), color=colour, lw=1.3)
    axes[0, 0].set(xlabel="east, m", ylabel="north, m", aspect="equal", xlim=(-1, 4.5),
                   ylim=(-6, 1.5), title="to a waypoint 20 m astern: the start")  # fmt: skip
    axes[0, 1].legend(*axes[0, 0].get_legend_handles_labels(), frameon=False, fontsize=8)
    axes[0, 1].axhline(180, color="black", lw=0.7, ls=":")
    axes[0, 1].set(xlabel="time, s", ylabel="heading, deg", title="heading")
    return figure


def design(
    thrusts: np.ndarray,
    levers: np.ndarray,
    least: np.ndarray,
    directions: np.ndarray,
    at_best: dict[str, np.ndarray],
    best: list[tuple[float, float]],
    published: tuple[float, float],
) -> Figure:
    """Least margin over thrust and lever; margin by direction at the two optima."""
    figure, axes = panels(1, 2, 10.0, 4.2)
    left, right = axes[0]
    levels = np.linspace(-5, 1, 13)
    shown = left.contourf(levers, thrusts, np.clip(least, -5, 1), levels, cmap="RdBu")
    left.contour(levers, thrusts, least, [0.0], colors="black", linewidths=1.2)
    figure.colorbar(shown, ax=left, label="margin in the worst direction, m")
    left.plot(*zip(*[(lever, thrust) for thrust, lever in best], strict=True), "*", color="black",
              ms=11, mfc="white", label="found by derivative")  # fmt: skip
    left.plot(published[1], published[0], "o", color="black", ms=6, mfc="white", label="published")
    left.set(xlabel="thruster ahead of the mass centre, m", ylabel="full thrust, N",
             title="swell of 20 N from any side")  # fmt: skip
    left.legend(fontsize=8, loc="lower left")
    for (name, margin), colour in zip(at_best.items(), (BLUE, ORANGE), strict=True):
        right.plot(np.rad2deg(directions), margin, color=colour, lw=1.3, label=name)
    right.axhline(0, color="black", lw=0.7)
    right.set(xlabel="direction of the swell, deg from the waypoint's bearing",
              ylabel="margin, m (1 where nearer than 1.5 m)",
              title="at the optima, published logic")  # fmt: skip
    right.legend(frameon=False, fontsize=7, loc="center right", bbox_to_anchor=(0.93, 0.6))
    return figure


def sweep(maps: dict[str, Map]) -> Figure:
    """Time to the waypoint over thrust and mass, by the direction of the swell."""
    figure, axes = panels(1, len(maps), 8.5, 3.5)
    for ax, (name, found) in zip(axes[0], maps.items(), strict=True):
        time = np.where(np.isfinite(found.time), found.time, np.nan)
        shown = ax.pcolormesh(found.thrust, found.mass, time.T, cmap="viridis", vmin=2, vmax=40,
                              rasterized=True)  # fmt: skip
        ax.plot(20.0, 7.0, "o", color="white", mec="black", ms=7, label="published boat")
        ax.set(xscale="log", yscale="log", xlabel="full thrust, N", ylabel="mass, kg",
               title=f"swell of 20 N towards {name}", facecolor="#d9d9d9")  # fmt: skip
        ax.set_xticks([5, 10, 20, 40, 80], labels=["5", "10", "20", "40", "80"])
        ax.set_yticks([3, 7, 15, 30, 60], labels=["3", "7", "15", "30", "60"])
        ax.minorticks_off()
        ax.legend(fontsize=8, loc="lower left")
    figure.colorbar(shown, ax=axes, label="time to the waypoint, s; grey: first attempt fails")
    return figure


SHOWN = ("D1", "D3", "D6", "D8", "D9")  # figures 7 to 11


def trials(tracks: dict[str, Track]) -> Figure:
    """Headings, track, speeds, forces and the thruster's angle, a column for each trial."""
    figure, axes = panels(5, len(SHOWN), 14.0, 12.0)
    for k, name in enumerate(SHOWN):
        track, (heading, path, speeds, forces, angle) = tracks[name], axes[:, k]
        number = disturbances.NAMES.index(name)
        bias, direction = disturbances.BIASES[number % 3], disturbances.DIRECTIONS[number // 3]
        north, east = disturbances.WAYPOINT
        bearing = np.unwrap(np.arctan2(east - track.y, north - track.x))
        heading.plot(track.t, np.rad2deg(bearing), color=GREY, ls="--", label="to the waypoint")
        heading.plot(track.t, np.rad2deg(track.psi), color=BLUE, label="of the boat")
        heading.set_title(f"{name}: {bias:.0f} N towards {np.rad2deg(direction):.0f} deg")
        path.plot(track.y, track.x, color=BLUE)
        circle(path, north, east, disturbances.TOLERANCE)
        path.set(xlabel="east, m", aspect="equal", adjustable="datalim")
        for value, colour, label in (
            (track.u, BLUE, "surge, m/s"), (track.v, RED, "sway, m/s"),
            (track.r, ORANGE, "yaw rate, rad/s"),
        ):  # fmt: skip
            speeds.plot(track.t, value, color=colour, lw=1.0, label=label)
        swell = bias + SWING * np.sin(2 * np.pi * FREQUENCY * track.t)
        thrust = track.commanded["thruster.force"]
        forces.plot(track.t, thrust, color=BLUE, lw=1.0, label="thrust, N")
        forces.plot(track.t, swell, color=GREY, lw=1.0, label="swell, N")
        angle.plot(track.t, np.rad2deg(track.commanded["thruster.angle"]), color=BLUE, lw=1.0)
        angle.set_xlabel("time, s")
    labels = ("heading, deg", "north, m", "speed", "force", "thruster's angle, deg")
    for ax, label in zip(axes[:, 0], labels, strict=True):
        ax.set_ylabel(label)
    for ax in axes[(0, 2, 3), 0]:
        ax.legend(frameon=False, fontsize=7)
    return figure


def requirements(angles: dict, near: dict[str, dict], distances: tuple[float, ...]) -> Figure:
    """Directions reached over the full angle, and runs over the distance of reduced thrust."""
    figure, axes = panels(1, 3, 13.0, 3.8)
    left, middle, right = axes[0]
    for one, colour in zip(angles["swell"][3:], (BLUE, ORANGE, RED), strict=True):
        left.plot(np.rad2deg(angles["angles"]), 100 * np.array(one["shares"]), "o-", color=colour,
                  ms=3, lw=1.2, label=f"swell of {one['bias']:.0f} N")  # fmt: skip
    left.set(xlabel="full thrust angle to either side, deg", ylabel="directions reached, %",
             title=f"{angles['swell'][-1]['thrust']:g} N of thrust", ylim=(0, 105))  # fmt: skip
    places = list(dict.fromkeys(name.rpartition(", ")[0] for name in near))
    for place, colour in zip(places, (GREY, "#444444", BLUE, RED), strict=True):
        rows = [near[f"{place}, {d:g} m"] for d in distances]
        for ax, key, factor in ((middle, "at_once", 100), (right, "median_time", 1)):
            shown = [factor * row[key] for row in rows]
            ax.plot(distances, shown, "o-", color=colour, ms=3, lw=1.2, label=place)
    for ax, label in ((middle, "reached at the first pass, %"), (right, "median time, s")):
        ax.axvspan(10, 20, color="#d1720f", alpha=0.15, label="recommended")
        ax.set(xscale="log", xlabel="wide turns have less thrust within, m", ylabel=label)
        ax.set_xticks(distances, labels=[f"{d:g}" for d in distances])
        ax.minorticks_off()
    left.legend(frameon=False, fontsize=8, loc="lower right")
    right.legend(frameon=False, fontsize=7)
    return figure
