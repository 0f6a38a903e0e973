"""A diagnosis in a few short lines, as the terminal and a notebook show it."""

import textwrap

from diffsea.report.quantities import duration, is_known, odds_or_bound
from diffsea.report.wording.caveats import (
    incomplete_sentence,
    sampling_sentence,
    side_sentences,
    straight_sentence,
)
from diffsea.report.wording.findings import (
    alike_findings,
    finding_line,
    heaviest_first,
    is_misread,
    misread_sentences,
)
from diffsea.report.wording.horizons import horizon_line
from diffsea.report.wording.verdicts import (
    MODELS,
    prediction_sentence,
    remainder_sentence,
    single_step_sentence,
    strongest_places,
    unimproved_sentence,
    verdict_sentence,
)
from diffsea.report.wording.words import (
    Record,
    acted_on,
    as_words,
    enumeration,
    named_effects,
    parameter_lines,
    together_note,
)


LINE_WIDTH = 88  # characters
LABEL_WIDTH = 7  # characters, of the word before a line
LISTED_FINDINGS = 5  # of the audit


def verdict_text(summary: Record) -> str:
    """The content of diagnosis.json in short lines."""
    named = named_effects(summary)
    rows = summary["held_out"]["horizons"]
    others = [one for one in heaviest_first(summary["audit"]) if not is_misread(one)]
    audit = [finding_line(group) for group in alike_findings(others, "unit")[:LISTED_FINDINGS]]
    what = []
    for effect in named:
        place = f" in {effect['recording']}" if "recording" in effect else ""
        acts_on = acted_on(effect)
        size = effect.get("evidence", {}).get("log10_odds")
        sure = f"; odds {odds_or_bound(size)}" if is_known(size) else ""
        sizes = ", ".join(parameter_lines(effect)) + together_note(effect)
        rivals = [as_words(name) for name in effect["alternatives"]]
        instead = f"; {enumeration(rivals, 'or')} would do as well" if rivals else ""
        what.append(f"{as_words(effect['name'])}{acts_on}{place}: {sizes}{sure}{instead}")
    following, proposal = "", summary["next_experiment"]
    if proposal:
        manoeuvre, seconds = "no manoeuvre", proposal.get("seconds")
        if is_known(seconds):
            manoeuvre = f"{as_words(proposal['manoeuvre'])} for {duration(seconds)}"
        following = f"{manoeuvre}: {proposal['why']}"
    places = strongest_places(summary)
    items = {
        "where": ["without what was found:"] * bool(named and places) + places,
        "what": what,
        "error": [
            *(horizon_line(row, MODELS if named else MODELS[1:]) for row in rows),
            unimproved_sentence(summary),
        ],
        "left": [
            remainder_sentence(summary),
            single_step_sentence(summary),
            incomplete_sentence(summary),
        ],
        "data": [
            *audit,
            sampling_sentence(summary["one_sample_in"]),
            straight_sentence(summary["straight_runs"]),
            *side_sentences(summary["sides"]),
        ],
        "next": [following],
    }
    misread = [f"Misread: {one}" for one in misread_sentences(summary)]
    head = [prediction_sentence(summary), *misread, verdict_sentence(summary)]
    lines = [line for text in head for line in textwrap.wrap(text, LINE_WIDTH)] + [""]
    wrapper = textwrap.TextWrapper(LINE_WIDTH, subsequent_indent=" " * LABEL_WIDTH)
    for label, texts in items.items():
        for text in filter(None, texts):
            wrapper.initial_indent = f"{label:<{LABEL_WIDTH}}"
            lines += wrapper.wrap(text)
            label = ""
    return "\n".join(lines).rstrip()
