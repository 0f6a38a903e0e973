"""Effects from the `[[effect]]` tables of a vessel file."""

from collections.abc import Sequence

import numpy as np

from diffsea.errors import UserError
from diffsea.vessel.base import Vessel
from diffsea.vessel.effects.entry import Effect
from diffsea.vessel.tables import Table, check_keys, needed


def read_table(
    vessel: Vessel, table: Table, variants: Sequence[Effect], where: str, others: Sequence[str] = ()
) -> Vessel:
    """The vessel with the effect of a table, whose keys are the effect's parameters.

    `where` names the table in messages; `others` are keys that have been read before.

    Raises:
        UserError: a key is unknown, a value is no number, or the vessel cannot have the effect.
    """
    keys = [key for variant in variants for key in variant.units]
    check_keys(table, tuple(dict.fromkeys(("name", *keys, *others))), where)
    # Where an effect has an entry of all its coefficients, its parts are of no use here.
    whole = [variant for variant in variants if variant.name == table["name"]]
    for variant in whole or variants:
        values = {key: needed(table, key, where) for key in variant.units if key in table}
        if not values and not whole:
            continue
        why = "" if variant.refusal is None else variant.refusal(vessel, values)
        if why:
            raise UserError(f"{where}: {why}")
        vessel = variant.apply(vessel, np.asarray(variant.encode(vessel, values)))
    return vessel


def read_names(table: Table, key: str, where: str, example: str = "") -> list[str] | None:
    """A list of names; None where the key is missing. Raises `UserError` for anything else."""
    names = table.get(key)
    if names is None or (isinstance(names, list) and all(isinstance(n, str) for n in names)):
        return names
    raise UserError(f"{where}: {key} = {names!r} is not a list of names{example}")
