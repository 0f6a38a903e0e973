"""Actuators: thrusters, propellers and rudders, each with its force, its role and its table.

The interface is `vessel.base.AbstractActuator`. What a vessel file calls an actuator is a key
of `ACTUATORS`; nothing else of the library knows the kinds.
"""

from collections.abc import Callable

from diffsea.vessel.actuators.propeller import Propeller as Propeller
from diffsea.vessel.actuators.rudders import DerivativeRudder as DerivativeRudder
from diffsea.vessel.actuators.rudders import Rudder as Rudder
from diffsea.vessel.actuators.rudders import rudder_from_table
from diffsea.vessel.actuators.thrusters import AzimuthThruster as AzimuthThruster
from diffsea.vessel.actuators.thrusters import FixedThruster as FixedThruster
from diffsea.vessel.actuators.thrusters import TunnelThruster as TunnelThruster
from diffsea.vessel.base import AbstractActuator, Vessel
from diffsea.vessel.tables import Table


# In the order in which a file's tables are read, so that a rudder knows the propellers.
ACTUATORS: dict[str, Callable[[str, Table, Vessel], AbstractActuator]] = {
    "thruster": FixedThruster.from_table,
    "azimuth_thruster": AzimuthThruster.from_table,
    "tunnel_thruster": TunnelThruster.from_table,
    "propeller": Propeller.from_table,
    "rudder": rudder_from_table,
}
