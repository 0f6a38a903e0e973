"""Which parameters are estimated online, and what is known of them beforehand."""

from collections.abc import Sequence

from diffsea.errors import UserError
from diffsea.parameters import Parameter, check_names, hull_prior, named
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects import EFFECTS


Choice = Sequence[str | Parameter]

# Numbers that are usually zero in a vessel file, with the catalogue's size of each.
_SIZES = {"current": EFFECTS["current"], "wind": EFFECTS["wind"]}


def chosen(vessel: Vessel, free: Choice) -> tuple[Parameter, ...]:
    """The parameters of a choice, those given by name with the prior of `hull_prior`.

    Their coordinate is the number itself, not its logarithm: motion is linear in most of them,
    and a filter that linearises once and never looks back goes astray in a logarithm. The sign
    is looked after by `online.trust`. A component of current or wind has the catalogue's size of
    that effect as its standard deviation.

    Raises:
        UserError: nothing chosen, an unknown name, one chosen twice, or a number that is zero
            in the vessel, whose scale cannot be told from it.
    """
    if not free:
        raise UserError("nothing to estimate: name at least one parameter of the vessel")
    names = [choice.name if isinstance(choice, Parameter) else choice for choice in free]
    check_names(vessel, names)
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice:
        raise UserError(f"parameter {twice!r} is chosen twice")
    values = named(vessel)
    return tuple(
        choice if isinstance(choice, Parameter) else _prior(vessel, choice, float(values[choice]))
        for choice in free
    )


def _prior(vessel: Vessel, name: str, value: float) -> Parameter:
    effect = _SIZES.get(name.split("_")[0]) if name.endswith(("_north", "_east")) else None
    if effect is not None:
        return Parameter(name, value, effect.sizes(vessel)[0], 1.0, unit="m/s")
    if value == 0:
        raise UserError(
            f"{name} is zero in the vessel, which says nothing of its size: give a Parameter "
            "with a scale, for example Parameter('sensors.gyro_bias', 0.0, scale=0.01)"
        )
    return linear(hull_prior(name, value))


def linear(parameter: Parameter) -> Parameter:
    """The same prior mean and standard deviation on the number itself, without bounds."""
    return Parameter(
        parameter.name, parameter.value, parameter.slope(0.0), parameter.spread,
        unit=parameter.unit,
    )  # fmt: skip
