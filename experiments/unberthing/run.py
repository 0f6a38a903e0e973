"""Unberthing under online estimation: Shioji Maru's control system, its failure and the cure."""

import itertools

from experiments.harness.reporting import comparison, experiment
from experiments.unberthing import unberthing_figures as figures
from experiments.unberthing import unberthing_stages as stages
from experiments.unberthing import unberthing_tables as tables
from experiments.unberthing.unberthing_panels import run_panels
from experiments.unberthing.unberthing_scores import score


def main() -> None:
    """Run the stages, write results, tables and figures."""
    run = experiment(__file__, __doc__)
    lanes, draws = (4, 2) if run.quick else (20, 10)
    control = stages.systems()
    published, cured = control["published"], control["trusted, push borne"]

    run.say("Exp. 1: unberthing")
    quay = stages.repeats(stages.EXP_1, 2 * draws)
    first = list(stages.logs(published, quay, lanes))
    cured_first = list(stages.logs(cured, quay, lanes))
    rows = tables.exp_1_rows(first, [score(log) for log in cured_first])

    run.say("Exps. 2 and 3: leaving, with eq. 16 three ways")
    away = {name: stages.repeats(weather, draws, stages.under_way) for name, weather in
            (("Exp. 2", stages.EXP_2), ("Exp. 3", stages.EXP_3))}  # fmt: skip
    leaving, variants = leave(stages.changed(published, first_step=3), away, lanes)
    rows += tables.leaving_rows(leaving, variants)

    run.say("seeds under every control system")
    seeds = range(1, 5) if run.quick else stages.SCORED
    names = ("published", "trusted, push borne") if run.quick else tuple(control)
    cases = stages.seeded(seeds)
    judged = {name: stages.scores(control[name], cases, lanes) for name in names}
    summaries = {name: tables.summary(found) for name, found in judged.items()}
    periods = {name: stages.seconds_per_period(control[name]) for name in names}
    rows += tables.period_rows(periods)
    beyond = {"seeds": len(seeds), "systems": summaries, "seconds_per_period": periods}
    texts = {"published": comparison(rows), "seeds": tables.scored_table(summaries)}
    if not run.quick:
        texts |= thorough(run, control, cases, beyond)
    failed = max(range(len(first)), key=lambda k: score(first[k]).wrong_way)
    run.save(figures.exp_1(first[failed], cured_first[failed]), "unberthing")
    run.save(run_panels(first[failed], quay[failed].weather, "Exp. 1"), "exp_1")
    for name, logs in leaving.items():
        title = name.lower().replace(". ", "_")
        run.save(run_panels(logs[0], away[name][0].weather, name), title)
    run.save(figures.leaving({name: logs[0] for name, logs in leaving.items()}), "leaving")
    run.save(figures.scored(judged, summaries | beyond.get("learning_rates", {})), "seeds")
    run.write({"comparison": rows, "beyond": beyond}, texts)


def leave(published, away: dict[str, list], lanes: int) -> tuple[dict, dict]:
    """Logs of the leaving phase, and scores with the compensation left out or as printed."""
    cases = [case for some in away.values() for case in some]

    def by_name(found: list) -> dict:
        left = iter(found)
        return {name: list(itertools.islice(left, len(some))) for name, some in away.items()}

    variants = {
        way: by_name(stages.scores(stages.changed(published, compensate=sign), cases, lanes))
        for way, sign in (("without eq. 16", 0), ("eq. 16 as printed", -1))
    }
    return by_name(list(stages.logs(published, cases, lanes))), variants


def thorough(run, control: dict, cases: list, beyond: dict) -> dict:
    """What only a full run does: delays of the plant, learning rates, and a faulty speed log."""
    run.say("delays that suit the plant")
    frozen = stages.at_rate(control["published"], 0.0)
    beyond["best_delays"] = stages.best_delays(list(stages.logs(frozen, cases[:20], 20)))
    run.say("other learning rates")
    beyond["learning_rates"] = {
        f"published, alpha {rate:g}": tables.summary(
            stages.scores(stages.at_rate(control["published"], rate), cases, 20)
        )
        for rate in stages.RATES
    }
    run.say("a speed log that is off for 40 s")
    faulty = stages.seeded(stages.SCORED, fault=True)
    names = ("published", "trusted, push borne", "no gate, push borne")
    beyond["faulty_log"] = {
        name: tables.summary(stages.scores(control[name], faulty, 20)) for name in names
    }
    return {
        "rates": tables.scored_table(beyond["learning_rates"]),
        "faults": tables.scored_table(beyond["faulty_log"]),
    }


if __name__ == "__main__":
    main()
