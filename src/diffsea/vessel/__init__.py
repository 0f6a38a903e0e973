"""Vessels: rigid body, forces, actuators with their servos, sensors, and their TOML files.

`base` has the interface of actuators and the sum of forces, `inertia` the rigid body and the added
mass, `forces` and `hull` what acts on it; a kind of actuator and a family of effects is a module
of its own. Everything is a tree of numbers in SI units that JAX differentiates. Imports nothing of
the library but kinematics, scales, types and errors.
"""

from diffsea.vessel.base import AbstractActuator as AbstractActuator
from diffsea.vessel.base import Vessel as Vessel
from diffsea.vessel.files import VesselFile as VesselFile
from diffsea.vessel.files import read_vessel as read_vessel
from diffsea.vessel.files import shipped_vessels as shipped_vessels
from diffsea.vessel.forces import AbstractForce as AbstractForce
from diffsea.vessel.forces import Force as Force
from diffsea.vessel.inertia import AddedMass as AddedMass
from diffsea.vessel.inertia import RigidBody as RigidBody
