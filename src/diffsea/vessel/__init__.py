"""Vessels: rigid body, forces, actuators with their servos, sensors, and their TOML files.

`base` has the interfaces and the sum of forces; a force, an actuator or an effect is a module of
its own. Everything is a tree of numbers in SI units that JAX differentiates. Imports nothing of
the library but kinematics, scales, types and errors.
"""

from diffsea.vessel.base import AbstractActuator as AbstractActuator
from diffsea.vessel.base import AbstractForce as AbstractForce
from diffsea.vessel.base import AddedMass as AddedMass
from diffsea.vessel.base import Force as Force
from diffsea.vessel.base import RigidBody as RigidBody
from diffsea.vessel.base import Vessel as Vessel
from diffsea.vessel.files import VesselFile as VesselFile
from diffsea.vessel.files import read_vessel as read_vessel
from diffsea.vessel.files import shipped_vessels as shipped_vessels
