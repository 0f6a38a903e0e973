"""Metamodels for validation (Gavrilin and Steen 2017): a year of service, repeats, real trials.

Run it as `python -m experiments.metamodels.run [--quick]`.
"""

from experiments.harness.reporting import experiment  # isort: skip

from experiments.metamodels import (
    averaging,
    beyond,
    ferry,
    gunnerus,
    pictures,
    recorded,
    repeated,
    tables,
)


SEED = 2017


def main() -> None:
    """All stages in order."""
    run = experiment(__file__, __doc__)
    quick = run.quick
    run.say("case 1: a year of service")
    service = ferry.study(SEED, 40 if quick else 365)
    run.say("case 2: repeated zig-zags on two days, at two speeds")
    repeats = gunnerus.study(SEED, 3 if quick else 12)
    run.say("averaging against the metamodel")
    if quick:
        errors = averaging.study(SEED, 8, (2, 6), ("calm", "7 to 11"))
    else:
        errors = averaging.study(SEED, 24)
    run.say("real zig-zags")
    sets = recorded.read(run.say)
    real, real_repeats = recorded.study(sets), repeated.study(sets)
    run.say("disturbances as nuisances")
    further = beyond.study(SEED, quick, service, run.say)
    pictures.all_of(run.save, service, repeats, errors, real, real_repeats, further)
    results = tables.results(service, repeats, errors, real, real_repeats, further)
    run.write(results, tables.tables(results))


if __name__ == "__main__":
    main()
