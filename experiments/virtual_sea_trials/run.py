"""Traceable virtual sea trials of a twin-thruster craft: tables 1 to 4, and what they determine.

Rezayan (2026), arXiv:2606.12349. See README.md.
"""

from experiments.harness.reporting import experiment  # noqa: I001  (sets up JAX)

from experiments.virtual_sea_trials import marus_stages as stages


def main() -> None:
    """Run every stage and write the results."""
    work = experiment(__file__, __doc__)
    identified = stages.identified(work)
    uneven = stages.asymmetry(work, identified)
    supported = stages.support(work, identified, uneven)
    campaign = stages.campaign(work)
    diameters = stages.diameters(work, identified)
    beyond = stages.actuation(work, campaign)
    stages.written(work, identified, uneven, supported, campaign, diameters, beyond)


if __name__ == "__main__":
    main()
