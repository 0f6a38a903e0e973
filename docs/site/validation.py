"""The validation page: every figure on it is read from a results.json while the site is built."""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from experiments.audit_power.faults import GRADED

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files


ROOT = Path(__file__).resolve().parents[2]
SYSTEMS = {
    "virtual_sea_trials": "A differential-thrust craft: traceable sea trials",
    "vrx_wamv": "The VRX simulator's WAM-V: identification and control",
    "unberthing": "A 54 m training ship leaving its berth",
    "metamodels": "Norrbin's model from a year of service",
    "pytheas": "A vectored-thruster boat among disturbances",
    "design_sweep": "Thrust and mass of many designs",
    "overshoot_sensitivity": "Overshoots against every derivative",
}


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the page."""
    files.append(File.generated(config, "validation.md", content=page()))
    return files


def page() -> str:
    """The page's Markdown."""
    parts = [
        "# Validation",
        "What the tool was compared with, and what came of it. Every figure below is read from the "
        "`results.json` of an experiment when the site is built; the experiment's own page has the "
        "question, the command and what the figures mean. Where published and obtained figures "
        "differ, the page of the experiment says why, as far as that is known.",
        "On real boats the diagnosis fails more often than on simulated ones: "
        "[when to believe a diagnosis](when-to-believe-a-diagnosis.md) lists its failures.",
        "## Is it chance?",
        chance(results("null_calibration")),
        "## Does the audit find a fault?",
        audit(results("audit_power")),
        "## Estimates from dimensions",
        estimates(results("estimate_check")),
        "## Published systems",
        *(system(name, title) for name, title in SYSTEMS.items()),
        "## Speed",
        speed(json.loads((ROOT / "benchmarks/results.json").read_text(encoding="utf-8"))),
    ]
    return "\n\n".join(parts) + "\n"


def results(experiment: str) -> dict[str, Any]:
    """What an experiment wrote."""
    path = ROOT / "experiments" / experiment / "results.json"
    return json.loads(path.read_text(encoding="utf-8"))


def chance(found: dict[str, Any]) -> str:
    """How often a level of chance was undercut where nothing is missing."""
    kinds = {"strongest": "of one effect", "located": "of the map of where"}
    rows = [
        (
            f"{kinds.get(row['kind'], row['kind'])}",
            f"{100 * row['level']:g} %",
            f"{row['hits']} of {row['n']}",
            f"{100 * row['low']:.1f} to {100 * row['high']:.1f} %",
        )
        for row in found["rates"]
    ]
    return (
        f"Data of {len(found['hulls'])} hulls from which nothing is missing, simulated and fitted "
        "anew each time: how often the stated probability of the strongest test falls below a "
        f"level. [The experiment]({readme('null_calibration')}).\n\n"
        + table(("strongest test", "level", "fell below", "95 % of the rate"), rows)
    )


def audit(found: dict[str, Any]) -> str:
    """Sizes at which the audit finds a fault, by set of recordings, and its false alarms."""
    alarms = [one["false alarms"].get("1e-05", one["false alarms"]) for one in found.values()]
    rows = [
        (
            "alarmed with nothing injected",
            "",
            *(f"{a['alarmed']} of {a['recordings']}" for a in alarms),
        )
    ]
    for fault in GRADED:
        rows.append((fault.name, fault.unit, *(_power(one[fault.name]) for one in found.values())))
    return (
        "Faults of growing size are put into simulated recordings and into real ones as repaired. "
        "The table has the size at which a fitted curve of power reaches 95 %; a dash where a set "
        f"lacks the channel or has the fault of its own. [The experiment]({readme('audit_power')})."
        "\n\n" + table(("fault", "unit", *found), rows)
    )


def _power(one: dict[str, Any]) -> str:
    if one["size"] is not None:
        return f"{one['size']:.2g}"
    return f"not in {one['never']} of {one['recordings']}" if one["never"] else "-"


def estimates(found: dict[str, Any]) -> str:
    """Estimates over stated values, by vessel."""
    vessels = found["vessels"]
    names = list(dict.fromkeys(name for one in vessels.values() for name in one["ratio"]))
    rows = [
        (vessel, *(number(one["ratio"].get(name)) for name in names))
        for vessel, one in vessels.items()
    ]
    return (
        "What `diffsea new` estimates from dimensions over what the vessel's file states. "
        f"[The experiment]({readme('estimate_check')}).\n\n" + table(("vessel", *names), rows)
    )


def system(name: str, title: str) -> str:
    """Published figures, or a rule's limits, beside those obtained."""
    found = results(name)["comparison"]
    beside = "limit" if "limit" in found[0] else "published"
    rows = [
        (
            row["quantity"],
            number(row[beside]),
            number(row["obtained"]),
            row["unit"],
            row["note"],
        )
        for row in found
    ]
    return f"### {title}\n\n[The experiment]({readme(name)}).\n\n" + table(
        ("quantity", beside, "obtained", "unit", "note"), rows
    )


def speed(found: dict[str, Any]) -> str:
    """The benchmarks, with the machine that they were measured on."""
    machine = found["machine"]
    rows = [
        (
            row["name"],
            f"{number(row['value'])} {row['unit']}",
            number(row.get("reference")),
            row.get("against") or "-",
            number(row.get("ratio")),
        )
        for row in found["figures"]
    ]
    return (
        f"On {machine['cores']} cores of an {machine['processor']}, Python {machine['python']}, "
        f"jax {machine['packages']['jax']}. A ratio above one: the library is the faster. "
        "[The benchmarks](repository/benchmarks/README.md).\n\n"
        + table(("figure", "library", "reference", "reference is", "ratio"), rows)
    )


def readme(experiment: str) -> str:
    """The page of an experiment."""
    return f"repository/experiments/{experiment}/README.md"


def number(value: object) -> str:
    """A number with four digits at most; words as they are."""
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.4g}"
    return str(value)


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown."""
    cells = [heads, ["---"] * len(heads), *rows]
    return "\n".join(
        "| " + " | ".join(one.replace("|", r"\|") for one in row) + " |" for row in cells
    )
