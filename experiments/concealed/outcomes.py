"""Each case judged: what the tool said beside what was true."""

import csv
import json
import math
import re
from dataclasses import dataclass, field
from pathlib import Path

from . import effects
from .effects_actuators import working_labels
from .hulls import HULLS, Hull
from .model import build


NO_NAME = ("unexplained", "none", "")
ONSET_SHARE = 0.05  # of the run's length: how near a time found must be
Z90 = 1.6449


@dataclass
class Outcome:
    """One case. `named` is what is asserted, `rivals` what is offered beside it."""

    case: str
    hull: str
    stratum: str
    true: list[str]
    keys: list[str]
    limits: list[float]
    verdict: str
    named: list[str]
    rivals: list[str]
    log10_odds: list[float | None]  # of each of `named`
    errors: dict[str, float] = field(default_factory=dict)  # relative, by "name.parameter"
    angles: dict[str, float] = field(default_factory=dict)  # rad
    covered: dict[str, bool] = field(default_factory=dict)
    onset: bool | None = None
    where: bool | None = None
    placed: dict[str, bool] = field(default_factory=dict)  # by true name, where it was named
    audited: list[str] = field(default_factory=list)
    gain: dict | None = None
    next_manoeuvre: str | None = None
    seconds: float | None = None
    warm: bool = True
    failure: str | None = None

    @property
    def decided(self) -> bool:
        """The tool explains the mismatch by names."""
        return self.verdict == "explained" and bool(self.named)

    @property
    def offered(self) -> set[str]:
        """The top set: names and what they cannot be told from."""
        return {*self.named, *self.rivals}

    @property
    def right(self) -> bool:
        """Exactly the true names are asserted."""
        return self.decided and set(self.named) == set(self.true)

    @property
    def strict(self) -> bool:
        """Right, and each in its place: channels, actuators, coefficients."""
        return self.right and all(self.placed.get(n, False) for n in self.true)

    @property
    def top(self) -> bool:
        """The strongest name is a true one."""
        return bool(self.named) and self.named[0] in self.true

    @property
    def wrong(self) -> bool:
        """A catalogue name is given that is not true.

        In an ambiguous case an entry is wrong when neither its name nor one of its rivals is true.
        """
        if self.verdict == "ambiguous":
            return bool(self.named) and not self.offered & set(self.true)
        return any(n not in self.true for n in self.named)


def read_all(folder: Path) -> list[Outcome]:
    """Outcomes of all cases with a result, by case."""
    plan = json.loads((folder / "sealed" / "plan.json").read_text(encoding="utf-8"))["cases"]
    found = []
    for case in plan:
        here = folder / "results" / case["id"]
        if (here / "run.json").exists():
            truth = json.loads((folder / "sealed" / f"{case['id']}.json").read_text("utf-8"))
            run = json.loads((here / "run.json").read_text(encoding="utf-8"))
            path = here / "diagnosis.json"
            diagnosis = json.loads(path.read_text(encoding="utf-8")) if path.exists() else None
            found.append(judge(truth, diagnosis, run))
    return found


def read_table(path: Path) -> list[Outcome]:
    """Cases of a `cases.csv`: what was true and what was said, but neither places nor onsets."""
    with path.open(encoding="utf-8", newline="") as file:
        return [_of_row(row) for row in csv.DictReader(file)]


def _of_row(row: dict[str, str]) -> Outcome:
    keys, named = _parts(row["true"]), _parts(row["named"])
    odds = re.split(_JOINED, row["log10 odds"])[: len(named)]
    return Outcome(
        row["case"], row["hull"], row["stratum"], [key.partition(":")[0] for key in keys], keys,
        [float(size) for size in _parts(row["limits"])], row["verdict"], named,
        _parts(row["rivals"]), [float(x) if x else None for x in odds],
        errors={str(k): float(x) for k, x in enumerate(_parts(row["errors"]))},
    )  # fmt: skip


_JOINED = r"(?<!\de)[+]"  # not within 1e+03


def _parts(cell: str) -> list[str]:
    return re.split(_JOINED, cell) if cell else []


def judge(truth: dict, diagnosis: dict | None, run: dict) -> Outcome:
    """Compare one diagnosis (None where the tool failed) with the truth."""
    keys = [e["key"] for e in truth["effects"]]
    out = Outcome(
        truth["id"], truth["hull"], truth["stratum"], list(truth["named"]), keys,
        [e["limits"] for e in truth["effects"]], "failed", [], [], [],
        seconds=run.get("seconds"), warm=run.get("warm", True), failure=run.get("error"),
    )  # fmt: skip
    if diagnosis is None:
        return out
    out.verdict = diagnosis["verdict"]
    out.next_manoeuvre = (diagnosis.get("next_experiment") or {}).get("manoeuvre")
    entries = [e for e in diagnosis["effects"] if e["name"] not in NO_NAME]
    strongest = {e["name"]: e for e in reversed(entries)}  # the first entry of each name
    out.named = list(dict.fromkeys(e["name"] for e in entries))
    out.rivals = list(dict.fromkeys(a for e in entries for a in e.get("alternatives", [])))
    out.log10_odds = [strongest[n].get("evidence", {}).get("log10_odds") for n in out.named]
    out.audited = sorted({f["kind"] for f in diagnosis.get("audit", [])})
    hull = HULLS[truth["hull"]]
    catalogue, seconds = effects.catalogue(hull), hull.rows * hull.step
    for key in keys:
        effect = catalogue[key]
        _parameters(out, effect, truth["named"], entries, seconds)
        said = [e for e in entries if e["name"] == effect.name]
        if said:
            values = truth["named"][effect.name]
            out.placed[effect.name] = any(_in_place(hull, effect, values, e) for e in said)
    _where(out, [catalogue[k] for k in keys], diagnosis.get("where", []))
    out.gain = _gain(diagnosis)
    return out


def _parameters(out: Outcome, effect, named: dict, entries: list[dict], seconds: float) -> None:
    """Errors, coverage and onset of one true effect, where it was named."""
    entry = next((e for e in entries if e["name"] == effect.name), None)
    if entry is None:
        return
    true, found = named[effect.name], entry["parameters"]
    value = lambda k: (found.get(k) or {}).get("value")
    label = lambda k: f"{effect.name}.{k}"
    main = [k for k in effect.main if value(k) is not None and k in true]
    if main:
        off = math.hypot(*(value(k) - true[k] for k in main))
        size = math.hypot(*(true[k] for k in main))
        # gamma_R is absent at one: its size is the distance from there.
        size = abs(1.0 - true["gamma_R"]) if main == ["gamma_R"] else size
        out.errors[label("+".join(main))] = off / max(size, 1e-12)
    for k in effect.circular:
        if value(k) is not None:
            out.angles[label(k)] = abs(wrap(value(k) - true[k]))
    for k in (*main, *effect.circular):
        std = (found.get(k) or {}).get("std")
        if std is not None and value(k) is not None:
            off = value(k) - true[k]
            off = wrap(off) if k in effect.circular else off
            out.covered[label(k)] = abs(off) <= Z90 * std
    if effect.onset:
        time = value("time")
        near = time is not None and abs(time - true["time"]) <= ONSET_SHARE * seconds
        out.onset = near if out.onset is None else out.onset and near


def _in_place(hull: Hull, effect, values: dict, entry: dict) -> bool:
    """Whether an entry has every main parameter of the truth, on its channels or actuators."""
    if not set(effect.main) <= set(entry["parameters"]):
        return False
    if "channels" in values and set(entry.get("channels", ())) != set(values["channels"]):
        return False
    if "actuators" in values:
        # An entry that acts on all channels does not list them.
        said = entry.get("actuators") or build(hull.document).labels()
        return set(said) == set(working_labels(hull, values["actuators"]))
    return True


def _where(out: Outcome, true: list, where: list[dict]) -> None:
    """Whether the first place named is in a degree of freedom in which a force is missing."""
    dofs = {d for e in true for d in e.dofs}
    if dofs and where:
        out.where = where[0]["degree_of_freedom"] in dofs


def _gain(diagnosis: dict) -> dict | None:
    """Root-mean-square position error 20 s ahead on held-out runs, nominal and diagnosed."""
    horizons = (diagnosis.get("held_out") or {}).get("horizons", [])
    found = next((h for h in horizons if h.get("seconds") == 20.0), None)
    if not found or "nominal" not in found or "diagnosed" not in found:
        return None
    return {k: found[k].get("position") for k in ("nominal", "diagnosed")}


def wrap(angle: float) -> float:
    """Into (-pi, pi]."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi
