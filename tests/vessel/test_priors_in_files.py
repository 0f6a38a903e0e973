"""[prior] in a vessel file: read with its mistakes told, used by fits, kept by what they write."""

import tomllib

import pytest
from tests.boats import BOAT

from diffsea import UserError, named, read_vessel
from diffsea.identification.coordinates import free_by_default
from diffsea.identification.study import with_priors
from diffsea.vessel.files import build, default_priors, dump, shipped_vessels, updated_document


@pytest.fixture
def boat(tmp_path):
    def write(prior: str):
        path = tmp_path / "boat.toml"
        path.write_text(BOAT.replace("max_force", "unit = 'us'\nmax_force") + prior)
        return read_vessel(path)

    return write


CURVE = '[prior]\n"port.thrust_curve.full_thrust" = { spread = 0.9 }\nX_u = { std = 4.0 }\n'


def test_a_file_without_priors_has_none_and_frees_what_it_always_did(boat):
    file = boat("")
    assert file.priors == {}
    free = with_priors(file.vessel, None, {})
    assert tuple(one.name for one in free) == free_by_default(file.vessel)
    known = default_priors(file.vessel)
    assert all(one == known[one.name] for one in free)
    for name in shipped_vessels():
        assert read_vessel(name).priors == {}


def test_priors_in_a_file_are_read_and_free_what_they_name(boat):
    file = boat(CURVE + "N_rr = { free = false }\n")
    free = {one.name: one for one in with_priors(file.vessel, None, file.priors)}
    assert free["X_u"].std == pytest.approx(4.0) and free["X_u"].upper == 0.0
    assert "N_rr" not in free and free["N_r"] == default_priors(file.vessel)["N_r"]
    thrust = free["port.thrust_curve.full_thrust"]
    assert thrust.spread == 0.9 and thrust.value == 400.0 and thrust.lower == 0.0
    assert "mass" not in free
    assert {"mass", "I_z"} <= {p.name for p in with_priors(file.vessel, None, {}, "thrust")}
    named = with_priors(file.vessel, ("X_u", "Y_v"), file.priors)
    assert [one.name for one in named] == ["X_u", "Y_v"] and named[0].std == pytest.approx(4.0)


@pytest.mark.parametrize(
    ("prior", "told"),
    [
        ("[prior]\nX_uuu = { spread = 1.0 }", r"boat.toml: \[prior\]: the vessel has no parameter"),
        ("[prior]\nX_u = { width = 1.0 }", "unknown key 'width'"),
        ("[prior]\nX_u = 3.0", "must be a table"),
        ("[prior]\nX_u = { value = 5.0 }", "not between the bounds"),
        ("[[prior]]\nX_u = 3.0", r"\[prior\] is a table"),
    ],
)
def test_mistakes_in_the_priors_of_a_file_are_told_when_it_is_read(boat, prior, told):
    with pytest.raises(UserError, match=told):
        boat(prior)


def test_a_fitted_file_keeps_the_means_of_its_priors(boat):
    """So that the same recordings, fitted again, do not count twice."""
    file = boat(CURVE)
    values = {"X_u": -55.0, "port.thrust_curve.full_thrust": 300.0, "N_r": -200.0}
    document = tomllib.loads(dump(updated_document(file.document, values, [])))
    assert document["hull"]["X_u"] == -55.0
    assert document["prior"]["X_u"] == {"std": 4.0, "value": -40.0}
    thrust = document["prior"]["port.thrust_curve.full_thrust"]
    assert thrust == {"spread": 0.9, "value": 400.0}
    assert "N_r" not in document["prior"]
    again = updated_document(document, {"X_u": -60.0}, [])
    assert again["prior"]["X_u"]["value"] == -40.0
    assert float(named(build(again))["X_u"]) == -60.0
