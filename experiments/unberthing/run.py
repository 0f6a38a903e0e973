"""Unberthing under online estimation: Shioji Maru's control system, its failure and the cure."""

import itertools

from experiments.harness.reporting import Experiment, comparison, experiment
from experiments.unberthing import unberthing_figures as figures
from experiments.unberthing import unberthing_stages as stages
from experiments.unberthing import unberthing_tables as tables
from experiments.unberthing import unberthing_variants as variants
from experiments.unberthing.unberthing_panels import run_panels
from experiments.unberthing.unberthing_scores import score


def main() -> None:
    """Run the stages, write results, tables and figures."""
    run = experiment(__file__, __doc__)
    lanes, draws = (4, 2) if run.quick else (20, 10)
    control = variants.systems()
    published, cured = control["published"], control["trusted, push borne"]

    run.save(figures.plan(), "route")
    run.say("Exp. 1: unberthing")
    quay = stages.repeats(stages.EXP_1, 2 * draws)
    first = list(stages.logs(published, quay, lanes))
    cured_first = list(stages.logs(cured, quay, lanes))
    rows = tables.exp_1_rows(first, [score(log) for log in cured_first])

    run.say("Exps. 2 and 3: leaving, with eq. 16 three ways")
    away = {name: stages.repeats(weather, draws, stages.under_way) for name, weather in
            (("Exp. 2", stages.EXP_2), ("Exp. 3", stages.EXP_3))}  # fmt: skip
    leaving, eq_16 = leave(stages.changed(published, first_step=3), away, lanes)
    rows += tables.leaving_rows(leaving, eq_16)

    beyond, texts = over_seeds(run, control, lanes)
    rows += tables.period_rows(beyond["seconds_per_period"])
    failed = max(range(len(first)), key=lambda k: score(first[k]).wrong_way)
    run.save(figures.exp_1(first[failed], cured_first[failed]), "unberthing")
    run.save(run_panels(first[failed], quay[failed].weather, "Exp. 1"), "exp_1")
    for name, logs in leaving.items():
        title = name.lower().replace(". ", "_")
        run.save(run_panels(logs[0], away[name][0].weather, name), title)
    run.save(figures.leaving({name: logs[0] for name, logs in leaving.items()}), "leaving")
    run.save(figures.scored(beyond["systems"], beyond["other_ship"]), "seeds")
    run.write({"comparison": rows, "beyond": beyond}, {"published": comparison(rows)} | texts)


def over_seeds(run: Experiment, control: dict, lanes: int) -> tuple[dict, dict[str, str]]:
    """Every control system on ships of both structures, and what each part of them does."""
    seeds = range(1, 5) if run.quick else stages.SCORED
    names = ("published", "no gate, push borne", "trusted, push borne")
    names = names if run.quick else tuple(control)
    beyond, texts = {"seeds": len(seeds), "differences": {}}, {}
    for key, plant in (("systems", stages.regression_ship), ("other_ship", stages.other_ship)):
        run.say(f"seeds under every control system: {key.replace('_', ' ')}")
        cases = stages.seeded(seeds, plant=plant)
        judged = {name: stages.scores(control[name], cases, lanes) for name in names}
        beyond[key] = {name: tables.summary(found) for name, found in judged.items()}
        beyond["differences"][key] = variants.differences(judged)
        texts[key] = tables.scored_table(beyond[key])
        texts[f"{key}_parts"] = variants.differences_table(beyond["differences"][key])
    beyond["seconds_per_period"] = {
        name: stages.seconds_per_period(control[name])
        for name in stages.TIMED_SYSTEMS if name in names
    }  # fmt: skip
    if not run.quick:
        texts |= thorough(run, control, beyond)
    return beyond, texts


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


def thorough(run: Experiment, control: dict, beyond: dict) -> dict[str, str]:
    """What only a full run does: delays of the plant, learning rates, and a faulty speed log."""
    run.say("delays that suit the plant")
    cases = stages.seeded(stages.SCORED)
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
    names = ("published", "slow, bias, push borne", "no gate, push borne", "trusted, push borne")
    texts = {"rates": tables.scored_table(beyond["learning_rates"])}
    for key, plant in (("faults", stages.regression_ship), ("others_faults", stages.other_ship)):
        faulty = stages.seeded(stages.SCORED, fault=True, plant=plant)
        judged = {name: stages.scores(control[name], faulty, 20) for name in names}
        beyond[key] = {name: tables.summary(found) for name, found in judged.items()}
        beyond["differences"][key] = variants.differences(judged)
        texts[key] = tables.scored_table(beyond[key])
    return texts


if __name__ == "__main__":
    main()
