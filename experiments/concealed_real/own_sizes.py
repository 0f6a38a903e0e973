"""What was injected, and what the runs have of the same kind by themselves.

    python -m experiments.concealed_real.own_sizes

A stated size is that of the recordings, to which a real boat adds its own: an antenna is never just
where its file says. So the names of each injected case whose sizes are judged are fitted to the
unchanged runs as well, beside what these are said to have. Writes `results/own_sizes.json`: sizes
injected, found, and the runs' own.
"""

import dataclasses
import json
from typing import Any

from experiments.concealed_real import cases, judging, sets
from experiments.concealed_real.checks import Line, acted_on
from experiments.concealed_real.results import FOLDER, read
from experiments.concealed_real.run import WORK

import diffsea


PATH = FOLDER / "own_sizes.json"


def judged_entries(line: Line, unchanged: Line) -> list[dict[str, Any]]:
    """Entries with a right name that the unchanged runs do not give, whose sizes are judged."""
    if not judging.judge(line, unchanged).covered:
        return []
    true, before = cases.truth(line["case"]), {e["name"] for e in unchanged["effects"]}
    return [e for e in line["effects"] if e["name"] in true["names"] and e["name"] not in before]


def in_catalogue(effect: dict[str, Any], vessel: Any) -> str:
    """The catalogue's name of an entry of diagnosis.json, with its variant.

    Raises:
        KeyError: there is none.
    """
    from diffsea.vessel.effects import EFFECTS, catalogue_name

    for name, entry in EFFECTS.items():
        alike = catalogue_name(name) == effect["name"] and entry.possible(vessel)
        place = [one for names in entry.place.in_file(vessel).values() for one in names]
        alike = alike and set(place) == set(acted_on(effect))
        if alike and set(effect["parameters"]) == set(entry.units):
            return name
    raise KeyError(effect["name"])


def own_sizes(line: Line, unchanged: Line) -> list[dict[str, Any]]:
    """A row for each judged number of a case; `own` is null where the runs show nothing."""
    material = sets.SETS[line["case"]["set"]].load()
    known = {"effect": unchanged["vessel"]["effect"]}
    material = dataclasses.replace(material, document=material.document | known)
    path, train, _ = material.write(WORK / "own" / line["id"])
    file = diffsea.read_vessel(path)
    true, rows = cases.truth(line["case"])["numbers"], []
    for entry in judged_entries(line, unchanged):
        name = in_catalogue(entry, file.vessel)
        own: dict[str, Any] = {}
        try:
            fitted = diffsea.fit(file, train, effects=[name], profiles=())
            own = fitted.study.effects[name][0]
        except diffsea.UserError as nothing:
            print(f"{line['id']}: {nothing}", flush=True)
        for key, value in true.items():
            stated = entry["parameters"].get(key)
            if key == "time" or stated is None or stated.get("std") is None:
                continue
            rows.append(
                {
                    "id": line["id"],
                    "name": name,
                    "number": key,
                    "injected": value,
                    "found": stated["value"],
                    "std": stated["std"],
                    "own": own[key]["value"] if own else None,
                    "own_std": own[key]["std"] if own else None,
                }
            )
    return rows


def main() -> None:
    """Fit those that the file has not yet, and add them to it."""
    unchanged = read("unchanged")
    rows = json.loads(PATH.read_text(encoding="utf-8")) if PATH.exists() else []
    for line in read("injected").values():
        beside, known = unchanged[line["case"]["set"]], {row["id"] for row in rows}
        if line["id"] not in known and judged_entries(line, beside):
            rows += own_sizes(line, beside)
            PATH.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
            print(json.dumps(rows[-1]), flush=True)


if __name__ == "__main__":
    main()
