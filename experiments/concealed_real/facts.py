"""Facts that are known independently of the tool: what is asked, what is accepted, how exactly.

Fixed before any of it was run. A fact is one diagnosis (or audit alone) of one set in one form, and
several checks of what it says.
"""

import dataclasses
from collections.abc import Callable

from experiments.concealed_real import measured, sets
from experiments.concealed_real.checks import (
    Check,
    Line,
    any_of,
    audited,
    named,
    not_audited,
    something_left,
    unnamed,
    within,
)
from experiments.concealed_real.injections import DROPPED, without_terms
from experiments.concealed_real.logs import zigzag_orders
from experiments.concealed_real.material import Material, Runs
from experiments.concealed_real.measured import DEGREE


WEATHER = ("wind", "current", "wave-force")
AS_PUBLISHED = "mapping.toml"


@dataclasses.dataclass(frozen=True)
class Fact:
    """Checks of one diagnosis, or of one audit, of what `material` gives."""

    material: Callable[[], Material]
    checks: tuple[Check, ...]
    audit_only: bool = False


# Each set in the form that is asked


def everything(runs: Runs, vessel: str) -> Material:
    """All recordings of a set, for an audit."""
    return Material(sets.document_of(vessel), runs, {})


def steering_gear() -> Material:
    """KVLCC2 with the orders of the zig-zag rule, the rudder hidden, and no slew rate known."""
    material = sets.SETS["hsva"].load()
    told = {name: zigzag_orders(name, run) for name, run in material.runs.items()}
    return Material(
        sets.without_rate_limit(material.document),
        {name: told[name] for name in material.train},
        {name: told[name] for name in material.test},
    )


def dropped(key: str) -> Callable[[], Material]:
    """KVLCC2 without some terms of the vessel file."""

    def material() -> Material:
        whole = sets.SETS["hsva"].load()
        return dataclasses.replace(whole, document=without_terms(whole.document, key))

    return material


def upright() -> Material:
    """KCS as if heel had not been measured."""
    whole = sets.SETS["kcs"].load()
    return whole.with_runs(lambda run: run.drop(columns=["phi", "p"]))


# The table


_VTEC = str(sets.DATA / "vtec_s3_2021" / "vessel.toml")
_DELAY = ("actuator-response", "thrust-delay")
_LAG = ("actuator-response", "thrust-lag")
_Z = tuple(f"HSVA_CPMC_KVLCC2_Z_{z}" for z in ("10_05", "10_10_P", "10_10_S", "15_05", "20_05",
                                              "20_10_S", "25_05", "30_05"))  # fmt: skip
_ESSO = ("random_06-Aug-2020_16_24_25_4", "random_06-Aug-2020_16_24_25_5",
         "turn_14-Oct-2020_14_29_49", "turn_14-Oct-2020_14_56_07", "turn_14-Sep-2020_13_51_45",
         "turn_14-Sep-2020_14_16_04", "zigzag_31-Jul-2020_13_04_24", "zigzag_31-Jul-2020_13_22_52",
         "zigzag_31-Jul-2020_13_42_53", "zigzag_31-Jul-2020_14_03_39")  # fmt: skip
_TOLERANCE = 0.03  # s, of a latency by an audit of one run
# The labels are exchanged in all runs; two are nearly straight, and one turns hardly.
_BOATS = tuple(f"fixed_00000{n}" for n in (218, 220, 221, 223, 224, 226, 228, 230, 232, 235))


def _vtec_others() -> list[str]:
    folder = sets.DATA / "vtec_s3_2021"
    return [f.name for f in sorted(folder.glob("*.csv")) if f.name not in sets.VTEC_EARTH]


FACTS: dict[str, Fact] = {
    "milliampere-feedback-hidden": Fact(sets.SETS["milliampere-orders"].load, (
        within("angles late by 0.5 to 0.7 s", _DELAY, "delay", 0.5, 0.7, (".angle",)),
        within("speeds late by 0.5 to 0.7 s", _DELAY, "delay", 0.5, 0.7, (".force",)),
        within("speeds lag by 0.5 to 1.3 s", _LAG, "time_constant", 0.5, 1.3, (".force",)),
        within("velocities late by 0.15 to 0.25 s", ("sensor-latency",), "delay", 0.15, 0.25,
               ("u", "v")),
    )),
    "kingfisher": Fact(sets.SETS["kingfisher"].load, (
        any_of("dead band 0.1 to 0.2 of full",
               within("", ("thrust-curve",), "deadband", 2.0, 4.0),
               within("", ("deadband",), "width", 2.0, 4.0)),
        # Orders that count no further than 0.7 of full, 14 N.
        any_of("no gain above 0.7",
               within("", ("thrust-curve",), "limit", 12.0, 16.0),
               within("", ("thrust-saturation",), "limit", 12.0, 16.0)),
        within("dead time 1.0 to 1.25 s", _DELAY, "delay", 1.0, 1.25),
        Check("thrust within 20 % of the bollard curve ahead", measured.thrust_is_measured),
    )),
    "vtec-axes": Fact(lambda: everything(sets.vtec(False), _VTEC), (
        audited("axes", sets.VTEC_EARTH),
        Check("audit: no axes in the sixteen others",
              lambda line: not_audited("axes", _vtec_others()).holds(line)),
    ), audit_only=True),
    "vtec": Fact(sets.SETS["vtec"].load, (
        unnamed(WEATHER),
        within("starboard near 0.78 of port", ("thrust-asymmetry",), "ratio", -0.18, -0.06,
               welcome=True),
        within("orders late by about 0.1 s", _DELAY, "delay", 0.05, 0.2, welcome=True),
    )),
    "hsva-audit": Fact(lambda: everything(sets.hsva(AS_PUBLISHED), "kvlcc2"), (
        audited("axes", _Z),
        audited("sign", _Z, channel="exec_rudder"),
    ), audit_only=True),
    "hsva-steering-gear": Fact(steering_gear, (
        within("slews at 15.3 to 15.8 deg/s", ("rate-limit", "actuator-response"), "rate_limit",
               15.3 * DEGREE, 15.8 * DEGREE),
        within("moves 0.24 to 0.32 s after the order", _DELAY, "delay", 0.24, 0.32),
        unnamed(WEATHER),
    )),
    **{f"hsva-{key}": Fact(dropped(key), (named(DROPPED[key].names), unnamed(WEATHER)))
       for key in ("without-lateral", "without-coupling", "without-interaction")},
    "hsva-unchanged": Fact(sets.SETS["hsva"].load, (unnamed(WEATHER),)),
    "kcs-heel-withheld": Fact(upright, (something_left(), unnamed(WEATHER))),
    "kcs-heel-given": Fact(sets.SETS["kcs"].load, (named(("roll-coupling",)), unnamed(WEATHER))),
    "esso-audit": Fact(lambda: everything(sets.esso(AS_PUBLISHED), "esso_osaka"), (
        audited("sensor-latency", _ESSO, 0.79 - _TOLERANCE, 0.94 + _TOLERANCE, at_least=9),
    ), audit_only=True),
    "esso-wind": Fact(sets.SETS["esso"].load, (
        named(("wind",)),
        Check("directions within 20 deg, in the median", measured.wind_direction_is_measured),
        Check("speeds within 25 %, in the median", measured.wind_speed_is_measured),
    )),
    "blueboat-audit": Fact(lambda: everything(sets.blueboat(AS_PUBLISHED), "blueboat"), (
        audited("swapped-actuators", _BOATS, at_least=7),
    ), audit_only=True),
}  # fmt: skip


def judge(key: str, line: Line) -> dict[str, bool | None]:
    """Every check of a fact; nothing holds where the tool failed."""
    checks = FACTS[key].checks
    if line.get("error"):
        return {check.what: False for check in checks}
    return {check.what: check.holds(line) for check in checks}
