"""A fleet as one page for people: which boats changed, what recurs, what could not be done."""

from collections import defaultdict
from collections.abc import Sequence

from diffsea.progress import counted
from diffsea.report.page import Table, Verbatim, provenance, render
from diffsea.report.quantities import is_known, significant
from diffsea.report.wording import words
from diffsea.report.wording.words import Record


SHOWN_MOVES = 4  # parameters of a boat, the furthest off its file
SHOWN_BOATS = 12  # by name, of those that have an effect in common


def fleet_report(record: Record, headline: str, changed: Sequence[str]) -> str:
    """The page.

    Arguments:
        record: what `FleetResult.record` gives.
        headline: in one line.
        changed: verdicts of boats that are not as their vessel file says.
    """
    boats = record["boats"]
    others = [one for one in boats if one.get("verdict") in changed]
    recordings = sum(len(one["recordings"]) for one in boats)
    audited = record["settings"]["until"] == "audit"
    source = {
        "settings": {key: value for key, value in record["settings"].items() if value is not None},
        "vessels": ", ".join(dict.fromkeys(one["vessel"] for one in boats)),
    }
    return render(
        "fleet.html.j2",
        title="Fleet",
        subtitle=f"{counted(len(boats), 'boat')}, {counted(recordings, 'recording')}",
        lead=f"{headline}.",
        fitted=not audited,
        changed=_changed(others),
        recurring=_recurring(record["recurring"], len(boats)),
        faults=_faults(boats),
        boats=_boats(boats),
        failures=_failures(boats),
        provenance=provenance(source, []),
    )


def _changed(boats: Sequence[Record]) -> Table:
    """The boats that are not as their file says: what was found, and which numbers are off."""
    rows = []
    for one in boats:
        found = words.phrases(words.named_effects({"effects": one["effects"]}))
        found = found or ["something that no entry of the catalogue explains"]
        rows.append([Verbatim(one["boat"]), one["verdict"], found, _moves(one)])
    columns = ["boat", "verdict", "what was found", "numbers off the vessel file"]
    return Table(columns, rows)


def _moves(one: Record) -> str:
    """Parameters that the data place beyond doubt elsewhere than the file, in per cent."""
    moved = sorted(one["moved"].items(), key=lambda item: -abs(item[1]))
    return ", ".join(f"{name} {100 * change:+.0f} %" for name, change in moved[:SHOWN_MOVES])


def _recurring(names: dict[str, list[str]], count: int) -> Table:
    """In how many boats each name was found."""
    rows = []
    for name, boats in names.items():
        told = ", ".join(boats[:SHOWN_BOATS]) + (" ..." if len(boats) > SHOWN_BOATS else "")
        rows.append([words.as_words(name), f"{len(boats)} of {count}", Verbatim(told)])
    return Table(["name", "boats", "which"], rows, numeric=(1,))


def _faults(boats: Sequence[Record]) -> Table:
    """In how many recordings, of how many boats, the audit found each kind of fault."""
    recordings: dict[str, int] = defaultdict(int)
    owners: dict[str, dict[str, None]] = defaultdict(dict)
    for one in boats:
        for row in one["recordings"]:
            for kind in dict.fromkeys(finding["kind"] for finding in row["audit"]):
                recordings[kind] += 1
                owners[kind][one["boat"]] = None
    order = sorted(recordings, key=lambda kind: -recordings[kind])
    rows = [[words.as_words(k), str(recordings[k]), str(len(owners[k]))] for k in order]
    return Table(["fault", "recordings", "boats"], rows, numeric=(1, 2))


def _boats(boats: Sequence[Record]) -> Table:
    """A row for each boat."""
    rows = []
    for one in boats:
        fit = one.get("fit", {})
        last = fit.get("diagnosed") or fit.get("nominal") or {}
        misfit = last.get("test") if is_known(last.get("test")) else last.get("train")
        done = sum(row["status"] == "done" for row in one["recordings"])
        rows.append(
            [
                Verbatim(one["boat"]),
                one.get("verdict", one["status"]),
                f"{done} of {len(one['recordings'])}",
                significant(misfit, 3) if is_known(misfit) else "",
                _moves(one),
            ]
        )
    columns = ["boat", "verdict", "recordings used", "misfit", "numbers off the vessel file"]
    caption = "Misfit in units of the noise, on recordings held out where there are any"
    return Table(columns, rows, caption, numeric=(2, 3))


def _failures(boats: Sequence[Record]) -> Table:
    """Boats and recordings that could not be done, and why."""
    rows = []
    for one in boats:
        if one["reason"]:
            rows.append([Verbatim(one["boat"]), "", Verbatim(one["reason"])])
        for row in one["recordings"]:
            if row["reason"] and row["reason"] not in one["reason"]:
                name = Verbatim(row["name"])
                rows.append([Verbatim(one["boat"]), name, Verbatim(row["reason"])])
    return Table(["boat", "recording", "why"], rows)
