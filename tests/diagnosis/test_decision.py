"""Which hypothesis of a short list is believed, on records of hypotheses."""

import dataclasses

import numpy as np
import pytest
from tests.diagnosis.small import CLEAR_GAIN, STEADY, UNSTEADY, candidate, hypothesis, judged

from diffsea import EFFECTS
from diffsea.diagnosis.bootstrap import NO_BOOTSTRAP
from diffsea.diagnosis.constancy import Constancy
from diffsea.diagnosis.decision import AcceptedEffect, ShortList, decide
from diffsea.diagnosis.first_hypotheses import FirstHypothesis
from diffsea.diagnosis.localisation import Bin, Cell
from diffsea.diagnosis.record import _reason
from diffsea.diagnosis.refits import with_mirrors
from diffsea.diagnosis.score import NullDistribution
from diffsea.diagnosis.screening import Screening
from diffsea.diagnosis.selection import Search
from diffsea.diagnosis.verdict import unexplained_p_value, verdict_on
from diffsea.identification.free_predictions import ChanceOfLoss, MotionChange
from diffsea.identification.holdout import Gain
from diffsea.identification.sufficiency import Shortfall


NEEDED = 11.0


def listed(*hypotheses) -> ShortList:
    return ShortList(hypotheses, NEEDED)


def left(z: float, p_value: float = 0.5, candidate_p: float = 1.0) -> Screening:
    """A screening of forces of which the strongest stands out by so many standard errors."""
    where = Bin(0, 0.0, 9.0, "")
    cells = (Cell(0, where, 0.5, 1.0, 0.9), Cell(1, where, -z, 1.0, p_value))
    one = candidate("wind", np.ones((3, 1)))
    one = dataclasses.replace(one, score=one.score._replace(p_value=candidate_p))
    return Screening({"wind": one}, cells, NullDistribution(np.ones(1000)))


@pytest.mark.parametrize(("total", "nameless"), [(None, True), (2.0, True), (-80.0, False)])
def test_what_held_out_runs_contradict_is_no_sign_of_something_unnamed(total, nameless):
    gain = None if total is None else Gain(total, 1.0)
    assert listed(hypothesis("wind", 60.0, gain=gain)).has_something_nameless == nameless


def test_what_diverged_is_no_sign_of_something_unnamed():
    assert not listed(hypothesis("wind", float("inf"))).has_something_nameless


def test_another_effect_is_sought_beside_steady_ones_first_where_the_best_is_not_steady():
    best, second = judged("wind", 160.0, UNSTEADY), judged("current", 130.0, STEADY)
    weak = judged("lever-arm", 3.0, STEADY)
    doubtful = judged("gyro-bias", 120.0, STEADY, Gain(8.0, 9.0))
    assert listed(best, second, weak, doubtful).pair_candidates() == [second, best]
    assert listed(doubtful, best, second).pair_candidates() == []
    assert listed().pair_candidates() == []


def test_what_predicts_the_motion_worse_gets_no_name_and_the_next_one_does():
    best, near = judged("wind", 60.0), judged("current", 57.0)
    assert decide(listed(best, near), None) is best
    harm = MotionChange({20.0: 2.0}, {20.0: ChanceOfLoss(1.0, 1.0)})
    worse = dataclasses.replace(best, motion=harm)
    assert decide(listed(worse, near), None) is near and not worse.still_stands(NEEDED)
    chance = dataclasses.replace(
        best, motion=dataclasses.replace(harm, worse={20.0: ChanceOfLoss(0.9, 1.0)})
    )
    assert decide(listed(chance, near), None) is chance
    little = dataclasses.replace(best, motion=dataclasses.replace(harm, ratio={20.0: 1.09}))
    assert decide(listed(little, near), None) is little


def test_a_size_that_may_as_well_be_zero_gets_no_name():
    """A fit with it ended far better, and yet with none of it: what was worse was the other fit."""
    best, near = judged("gyro-bias", 160.0), judged("current", 155.0)
    nothing = dataclasses.replace(best, zero_p_value=0.3)
    assert decide(listed(best, near), None) is best and best.still_stands(NEEDED)
    assert decide(listed(nothing, near), None) is near and not nothing.still_stands(NEEDED)
    assert _reason(nothing, 1.0, NEEDED) == "its size may as well be zero"


def test_of_two_that_are_supported_nearly_as_well_the_motion_tells():
    best, near = judged("clock-drift", 60.0), judged("roll-coupling", 55.0)
    change = {"ratio": 0.6, "chance": 0.009}

    def compare(one, other):
        assert (one, other) == (best, near)
        chances = ChanceOfLoss(change["chance"], change["chance"])
        return MotionChange({60.0: change["ratio"]}, {60.0: chances})

    assert decide(listed(best, near), None, compare) is near
    assert decide(listed(best, near)) is best
    change["chance"] = 0.011
    assert decide(listed(best, near), None, compare) is best
    change |= {"chance": 0.001, "ratio": 0.95}
    assert decide(listed(best, near), None, compare) is best
    change["ratio"] = 0.6
    behind = judged("roll-coupling", 49.0)
    assert decide(listed(best, behind), None, compare) is best
    unsteady = judged("roll-coupling", 55.0, UNSTEADY)
    assert decide(listed(best, unsteady), None, compare) is best
    assert AcceptedEffect(near, listed(best, near)).rivals == ("clock-drift",)


def test_what_fails_bars_only_what_does_much_the_same():
    """Of two effects that are both there, each spoils what runs held out say of the other."""
    strongest = judged("feedback-error:steering-offset", 280.0, gain=Gain(-5.0, 60.0))
    alike = judged("sensor-latency:heading", 180.0)
    assert decide(listed(strongest, alike)) is None
    columns = np.array([[1.0], [-1.0], [0.0]])  # those of the strongest are all one
    unlike = dataclasses.replace(
        alike, candidate=dataclasses.replace(alike.candidate, columns=columns)
    )
    tried = listed(strongest, unlike)
    assert decide(tried) is unlike
    accepted = AcceptedEffect(unlike, tried)
    assert accepted.rivals == () and accepted.lead == pytest.approx(unlike.support(1.0))
    near = judged("feedback-error:steering-offset", unlike.support(1.0), gain=Gain(0.0, 60.0))
    assert AcceptedEffect(unlike, listed(near, unlike)).rivals == ("feedback-error",)


def test_the_motion_does_not_make_a_wind_of_a_property_of_the_hull():
    hull, wind = judged("roll-coupling", 60.0), judged("wind", 58.0)
    better = MotionChange({60.0: 0.5}, {60.0: ChanceOfLoss(0.0, 0.0)})
    assert decide(listed(hull, wind), None, lambda one, other: better) is hull


def test_a_law_of_the_vessel_comes_before_a_record_that_is_off():
    """Of two that are supported nearly as well; not one of the same actuator's orders."""
    record = judged("feedback-error:steering-scale", 160.0)
    law, order = judged("rudder-interaction", 155.0), judged("actuator-bias:steering", 155.0)
    assert decide(listed(record, law), None) is law
    assert decide(listed(record, order), None) is record
    ahead = judged("drag-change:surge", 155.0)  # the hull's, if not in all directions
    assert decide(listed(record, ahead), None) is ahead
    assert decide(listed(record, judged("rudder-interaction", 145.0)), None) is record


def test_a_size_that_is_nearly_one_does_where_the_motion_is_predicted_better():
    better = MotionChange({20.0: 0.3}, {20.0: ChanceOfLoss(0.0, 0.0)})
    assert better.is_better and not better.is_worse
    nearly = dataclasses.replace(judged("wind", 60.0, UNSTEADY._replace(share=0.4)), motion=better)
    assert decide(listed(nearly), None) is nearly
    for motion in (None, dataclasses.replace(better, worse={20.0: ChanceOfLoss(0.0, 0.1)}),
                   dataclasses.replace(better, worse={20.0: ChanceOfLoss(0.2, 0.0)})):  # fmt: skip
        assert decide(listed(dataclasses.replace(nearly, motion=motion)), None) is None
    assert decide(listed(dataclasses.replace(nearly, constancy=UNSTEADY)), None) is None
    mixed = MotionChange(
        {20.0: 0.3, 60.0: 2.0}, {20.0: ChanceOfLoss(0.0, 0.0), 60.0: ChanceOfLoss(1.0, 1.0)}
    )
    assert not mixed.is_better


def test_a_size_that_is_nearly_one_is_asked_of_all_runs_where_they_can_change_places():
    tried = MotionChange({20.0: 0.8}, {20.0: ChanceOfLoss(0.1, 0.2)})
    better = MotionChange({20.0: 0.7}, {20.0: ChanceOfLoss(0.0, 0.001)})
    nearly = judged("wind", 60.0, UNSTEADY._replace(share=0.4))

    def asked(motion, pooled=better, gain=CLEAR_GAIN, constancy=nearly.constancy):
        one = dataclasses.replace(nearly, motion=motion, gain=gain, constancy=constancy)
        agrees = lambda one: dataclasses.replace(one, exchanged=CLEAR_GAIN, motion=pooled)
        return decide(listed(one), agrees)

    assert asked(tried) and asked(better) and asked(tried, gain=Gain(8.0, 9.0))
    assert asked(tried, pooled=tried) is None
    # By the runs held out alone it is believed, but the others contradict it.
    sure = dataclasses.replace(nearly, motion=better)
    assert decide(listed(sure), None) is sure
    assert decide(listed(sure), exchanged(-200.0, 20.0)) is None
    assert asked(dataclasses.replace(tried, ratio={20.0: 1.1})) is None
    assert asked(tried, gain=Gain(-30.0, 9.0)) is None
    assert asked(tried, constancy=UNSTEADY) is None


def test_what_is_surely_better_on_runs_held_out_need_only_probably_be_so_on_all():
    surely = MotionChange({20.0: 0.8, 60.0: 0.9}, {20.0: ChanceOfLoss(0.0, 0.001),
                                                   60.0: ChanceOfLoss(0.1, 0.2)})  # fmt: skip
    nearly = dataclasses.replace(judged("wind", 60.0, UNSTEADY._replace(share=0.4)), motion=surely)

    def asked(ratio: float, *chances: ChanceOfLoss):
        motion = MotionChange(
            dict.fromkeys((20.0, 60.0), ratio), dict(zip((20.0, 60.0), chances, strict=True))
        )
        agrees = lambda one: dataclasses.replace(
            one, exchanged=CLEAR_GAIN, motion=motion, held_out_motion=one.motion
        )
        return decide(listed(nearly), agrees)

    probable, open_, harm = ChanceOfLoss(0.01, 0.04), ChanceOfLoss(0.3, 0.4), ChanceOfLoss(1.0, 1.0)
    assert asked(0.9, probable, open_)
    assert asked(0.9, open_, probable) is None  # at another horizon than on the runs held out
    assert asked(1.2, probable, harm) is None


def test_a_law_with_one_size_in_every_run_does_where_other_runs_are_predicted_better():
    better = MotionChange({20.0: 0.8}, {20.0: ChanceOfLoss(0.0, 0.0)})
    within = UNSTEADY._replace(share=1.1, same_in_runs=True)
    law = dataclasses.replace(judged("rudder-interaction", 60.0, within), motion=better)
    assert decide(listed(law), None) is law
    # A wind, or a sensor's error, has no law that only nearly holds.
    for name in ("wind", "gyro-bias"):
        other = dataclasses.replace(judged(name, 60.0, within), motion=better)
        assert decide(listed(other), None) is None
    open_gain = dataclasses.replace(law, gain=Gain(8.0, 9.0))
    apart = dataclasses.replace(law, constancy=within._replace(same_in_runs=False))
    for doubtful in (open_gain, apart, dataclasses.replace(law, motion=None)):
        assert decide(listed(doubtful), None) is None


def test_what_single_steps_leave_open_is_decided_by_free_predictions():
    spoilt = judged("wind", 60.0, STEADY, Gain(-8.0, 9.0))
    assert decide(listed(spoilt), None) is None
    for chances, named in (((0.03, 0.04), True), ((0.03, 0.06), False), ((0.06, 0.0), False)):
        motion = MotionChange({20.0: 0.9}, {20.0: ChanceOfLoss(*chances)})
        one = dataclasses.replace(spoilt, motion=motion)
        assert decide(listed(one), None) is (one if named else None)
    surely, hardly = ChanceOfLoss(0.0, 0.0), ChanceOfLoss(0.97, 0.96)
    mixed = MotionChange({20.0: 0.9, 60.0: 1.2}, {20.0: surely, 60.0: hardly})
    harmed = dataclasses.replace(one, motion=mixed)
    assert decide(listed(harmed), None) is None
    better = MotionChange({20.0: 0.9}, {20.0: surely})
    lost = dataclasses.replace(judged("wind", 60.0, STEADY, Gain(-20.0, 9.0)), motion=better)
    assert decide(listed(lost), None) is None


def exchanged(total: float, std: float):
    return lambda one: dataclasses.replace(one, exchanged=Gain(total, std))


def test_what_is_asked_of_the_best_alone_does_not_distance_its_rivals():
    best = judged("wind", 60.0, STEADY, Gain(12.0, 7.0))
    near = judged("current", 57.0, STEADY, Gain(12.0, 7.0))
    found = decide(listed(best, near), exchanged(30.0, 7.0))
    assert found is not None and found.pooled_gain is not None
    assert found.effect == "wind" and found.pooled_gain.total == 42.0
    accepted = AcceptedEffect(found, listed(best, near))
    assert accepted.rivals == ("current",)
    assert accepted.lead == pytest.approx(3.0)


def test_held_out_data_that_leave_a_name_open_do_not_give_it():
    open_one = judged("wind", 60.0, STEADY, Gain(12.0, 7.0))
    assert decide(listed(open_one), None) is None
    assert decide(listed(open_one), exchanged(-12.0, 7.0)) is None
    found = decide(listed(judged("wind", 60.0)), None)
    assert found is not None and found.effect == "wind"


def test_gains_that_may_be_losses_do_not_tell_rivals_apart():
    unsteady = judged("clock-drift", 60.0, UNSTEADY, Gain(-26.0, 68.0))
    steady = judged("thrust-delay:propulsion", 64.0, STEADY, Gain(-50.0, 71.0))
    found = decide(listed(unsteady, steady), exchanged(244.0, 16.0))
    assert found is not None and found.effect == steady.effect
    lost = dataclasses.replace(steady, gain=Gain(-150.0, 71.0))
    assert decide(listed(unsteady, lost), exchanged(444.0, 16.0)) is None


def test_a_name_needs_evidence_one_size_and_to_be_near_the_best():
    assert decide(listed(judged("wind", NEEDED - 1)), None) is None
    assert decide(listed(judged("wind", 60.0, UNSTEADY)), None) is None
    best = judged("wind", 60.0, UNSTEADY)
    found = decide(listed(best, judged("current", 51.0)), None)
    assert found is not None and found.effect == "current"
    assert decide(listed(best, judged("current", 49.0)), None) is None
    assert decide(listed(hypothesis("wind", 60.0, STEADY, CLEAR_GAIN, False)), None) is None


def test_rivals_are_other_names_that_were_judged_and_come_near():
    best = judged("thrust-lag:propulsion", 60.0)
    others = [
        judged("thrust-lag", 59.0),
        judged("current", 51.0),
        judged("wind", 49.0),
        hypothesis("gyro-bias", 59.0, STEADY, CLEAR_GAIN, is_physical=False),
        hypothesis("lever-arm", 59.0),
    ]
    assert AcceptedEffect(best, listed(best, *others)).rivals == ("current",)


@pytest.mark.parametrize(
    ("constancy", "gain", "stands"),
    [
        (STEADY, CLEAR_GAIN, True),
        (STEADY, Gain(1.0, 9.0), True),  # beside others held-out data may leave it open
        (STEADY, Gain(-40.0, 9.0), False),
        (UNSTEADY, CLEAR_GAIN, False),
        (Constancy(60.0, 1e-9, 0.3), CLEAR_GAIN, True),  # of nearly one size, as motion said once
        (Constancy(60.0, 1e-9, 0.3), Gain(-40.0, 9.0), False),
        (None, CLEAR_GAIN, False),
        (STEADY, None, False),
    ],
)
def test_an_effect_stands_unless_evidence_or_held_out_data_speak_against_it(
    constancy, gain, stands
):
    assert hypothesis("wind", 60.0, constancy, gain).still_stands(NEEDED) == stands
    assert not hypothesis("wind", NEEDED, constancy, gain).still_stands(NEEDED)


@pytest.mark.parametrize(
    ("rivals", "p_value", "short", "verdict"),
    [
        (None, 0.4, (), "consistent"),
        (None, 0.4, (Shortfall.GUSTS,), "insufficient"),
        (None, 1e-5, (), "unexplained"),
        ((), 0.4, (), "explained"),
        ((), 0.4, (Shortfall.PARAMETERS,), "explained"),
        ((), 0.4, (Shortfall.MISFIT,), "unexplained"),  # runs held out are still missed
        ((), 0.4, (Shortfall.MOTION,), "unexplained"),
        (("wind",), 0.4, (), "ambiguous"),
        (("wind",), 1e-5, (), "unexplained"),  # a name for a part, and a remainder without one
    ],
)
def test_a_verdict_depends_on_names_rivals_and_what_is_left(rivals, p_value, short, verdict):
    accepted = ()
    if rivals is not None:
        best = judged("current", 60.0)
        others = [judged(name, 55.0) for name in rivals]
        accepted = (AcceptedEffect(best, listed(best, *others)),)
    assert verdict_on(accepted, p_value, short) == verdict


@pytest.mark.parametrize(
    ("evidence", "expected", "verdict"), [(60.0, 1e-5, "unexplained"), (3.0, 0.4, "consistent")]
)
def test_the_chance_that_is_stated_is_the_one_that_decided(evidence, expected, verdict):
    """Something that no name could be given to makes the strongest of all tests decide."""
    null = NullDistribution(np.linspace(0.0, 1.0, 100_001)[1:])
    screening = dataclasses.replace(left(1.0, p_value=0.4, candidate_p=1e-5), null=null)
    one = hypothesis("wind", evidence, UNSTEADY)
    fitted, tried = one.estimate, listed(one)
    found = Search(fitted, screening, fitted, screening, short_list=tried)
    p_value = unexplained_p_value(found, found, NO_BOOTSTRAP)
    assert p_value == pytest.approx(expected, rel=0.1)
    assert verdict_on((), p_value) == verdict
    # Beside a fault that the audit had found, too.
    fault = AcceptedEffect(judged("gyro-bias", 90.0), listed())
    beside = dataclasses.replace(
        found, effects=(fault,), first=(FirstHypothesis("gyro-bias", np.ones(1)),)
    )
    assert unexplained_p_value(beside, beside, NO_BOOTSTRAP) == p_value


def test_what_was_left_before_a_name_was_withdrawn_counts():
    null = NullDistribution(np.linspace(0.0, 1.0, 100_001)[1:])
    before, after = (dataclasses.replace(left(1.0, p_value=p), null=null) for p in (0.02, 0.4))
    fitted = judged("wind", 60.0).estimate
    kept, final = (Search(fitted, one, fitted, one) for one in (before, after))
    assert unexplained_p_value(kept, final, NO_BOOTSTRAP) == pytest.approx(0.02, rel=0.1)


def test_what_failed_leaves_behind_only_what_it_mimics():
    seen = np.eye(4)

    def with_columns(one, *columns):
        return dataclasses.replace(
            one, candidate=dataclasses.replace(one.candidate, columns=seen[:, list(columns)])
        )

    failed = with_columns(judged("sensor-latency:yaw_rate", 300.0, UNSTEADY), 0, 1)
    alike = with_columns(hypothesis("clock-drift", 90.0), 0)
    other = with_columns(hypothesis("thrust-delay:propulsion", 90.0), 2)
    weak = with_columns(hypothesis("thrust-lag:propulsion", 3.0), 2)
    wild = with_columns(hypothesis("backlash:propulsion", 90.0, is_physical=False), 3)
    assert decide(listed(failed, other), None) is None
    left_behind = listed(failed, alike, other, weak, wild).left_behind()
    assert left_behind == ("thrust-delay:propulsion",)


def test_what_had_evidence_is_owed_an_answer_beside_what_was_accepted():
    accepted, strong = judged("sensor-latency:velocity", 300.0), judged("wind", 60.0)
    same, weak = judged("sensor-latency:yaw_rate", 90.0), judged("current", 3.0)
    assert listed(accepted, same, strong, weak).owed_beside(accepted) == ("wind",)


def test_what_may_be_negative_is_asked_for_as_its_mirror_too():
    early, late = "sensor-latency:but_position", "sensor-latency:position"
    assert with_mirrors([late, "wind"]) == [late, "wind", early]
    assert with_mirrors([early, late]) == [early, late]
    assert all(EFFECTS[e.mirror].mirror == name for name, e in EFFECTS.items() if e.mirror)


def test_of_a_whole_and_its_part_the_part_is_named_unless_the_whole_explains_more():
    whole, part = judged("actuator-response:steering", 63.0), judged("thrust-delay:steering", 60.0)
    assert decide(listed(whole, part), None) is part
    assert AcceptedEffect(part, listed(whole, part)).rivals == ()
    assert AcceptedEffect(part, listed(whole, part)).lead == part.evidence(1.0) + CLEAR_GAIN.sure
    unsteady = dataclasses.replace(part, constancy=UNSTEADY)
    assert decide(listed(whole, unsteady), None) is whole
    assert AcceptedEffect(whole, listed(whole, part)).rivals == ()
    more = judged("actuator-response:steering", 90.0)
    assert decide(listed(more, part), None) is more
    elsewhere = judged("thrust-delay:propulsion", 60.0)
    assert decide(listed(whole, elsewhere), None) is whole
    assert AcceptedEffect(whole, listed(whole, elsewhere)).rivals == ("thrust-delay",)


def test_weather_is_named_where_nothing_of_the_vessel_does_nearly_as_well():
    wind, hull = judged("wind", 63.0), judged("added-mass-coupling", 60.0)
    assert decide(listed(wind, hull), None) is hull
    assert AcceptedEffect(hull, listed(wind, hull)).rivals == ("wind",)
    windy = judged("wind", 90.0)
    assert decide(listed(windy, hull), None) is windy
    sensor = judged("heading-offset", 60.0)
    assert decide(listed(wind, sensor), None) is wind
    unsteady = dataclasses.replace(hull, constancy=UNSTEADY)
    assert decide(listed(wind, unsteady), None) is wind
