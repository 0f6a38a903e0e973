"""A twin-thruster boat identified and steered along waypoints: the WAM-V of the VRX simulator."""

import dataclasses

from experiments.harness.reporting import comparison, experiment
from experiments.vrx_wamv import outside_class, outside_draws, plots, stages, tables
from experiments.vrx_wamv.campaign import held_out
from experiments.vrx_wamv.diagnosed import diagnosed


FOLLOWED = ("published", tables.THRUST, "joint")


def main() -> None:
    """Run the stages, write results, tables and figures."""
    run = experiment(__file__, __doc__)
    checks = stages.checks()
    run.say("reference plant checked; the paper's procedure")
    found = stages.identification(run.quick, run.say)
    arithmetic = stages.arithmetic(found)
    errors = stages.predictions(found)
    run.say("following paths")
    followed = stages.following(found, FOLLOWED if not run.quick else ("joint",))
    run.say("tuning gains through the closed loop")
    tuned = {"tuned": stages.tuning(found, followed.gains, 4 if run.quick else 15, "joint")}
    if not run.quick:
        name = f"tuned on {tables.THRUST}"
        tuned[name] = stages.tuning(found, followed.gains, 15, tables.THRUST)
    gains = {"by hand": followed.gains} | {name: one.gains for name, one in tuned.items()}
    ways, quiet = stages.verified(gains, noisy=False)
    rows = [
        *tables.plant_rows(checks), *tables.procedure_rows(found, arithmetic),
        *tables.mass_rows(), *tables.path_rows(followed),
    ]  # fmt: skip
    compared = stages.laws(found.vessel("joint"), gains, 4 if run.quick else 15)
    results = {
        "comparison": rows, "checks": checks, "values": found.values, "seconds_of": found.seconds,
        "arithmetic": arithmetic, "prediction_errors": errors, "paths": followed.table,
        "laws": {"fixed": compared.gains, "on_plant": compared.table},
        "beyond": {"gains": gains, "verified": quiet,
                   "costs": {name: one.costs for name, one in tuned.items()}},
    }  # fmt: skip
    texts = {"published": comparison(rows), "quality": tables.quality(found, errors),
             "parameters": tables.parameters(found), "paths": tables.paths(followed),
             "laws": tables.laws(compared.table)}  # fmt: skip
    if not run.quick:
        thorough(run, found, followed, gains, tuned, quiet, results, texts)
        run.save(plots.identification(found), "identification")
        run.save(plots.from_rest(found), "from_rest")
        run.save(plots.following(followed.plant, followed.models), "paths")
        run.save(plots.laws(compared.runs), "laws")
        run.save(plots.tuned(ways, tuned["tuned"]), "tuned")
    run.write(results, texts)


def thorough(run, found, followed, gains, tuned, quiet, results, texts) -> None:
    """What only a full run does: noise in the loop, repeats, derivatives checked, diagnosis."""
    run.say("steering with noise; the fit again on other noise and on the older drag")
    _, noisy = stages.verified(gains, noisy=True)
    again = stages.repeats(found)
    slopes = stages.derivatives(found, gains["tuned"])
    scale = stages.scale(found)
    linear = found.values["joint, linear"]
    record = diagnosed([*held_out(stages.SEED + 200), found.data.wide], linear, run.say)
    run.save(plots.diagnosis(record), "diagnosis")
    run.say("a plant outside the model class")
    elsewhere = outside_class.outside(run.say)
    run.save(plots.outside(elsewhere), "outside_class")
    results["scale"] = scale
    results["repeats"] = again
    results["beyond"] |= {
        "verified_with_noise": noisy,
        "slopes": slopes,
        "diagnosis": record,
        "outside_class": dataclasses.asdict(elsewhere),
    }
    texts |= {
        "scale": tables.gauge(scale), "verified": tables.verified(quiet, noisy),
        "gains": tables.gains(gains, tuned), "slopes": tables.slopes(slopes),
        "diagnosis": tables.diagnosis(record),
        "outside_predictions": outside_class.predictions_table(elsewhere),
        "outside_draws": outside_draws.medians_table(elsewhere.draws),
        "outside_differences": outside_draws.differences_table(elsewhere.draws),
        "outside_times": outside_draws.times_table(elsewhere.draws),
        "outside_gains": outside_class.tuned_table(elsewhere),
        "outside_diagnosis": outside_class.diagnosis_table(elsewhere.diagnosis),
        "repeats": tables.repeats(again, found.values["joint"]),
    }  # fmt: skip


if __name__ == "__main__":
    main()
