"""Vessels: rigid body, forces, actuators with their servos, sensors, and their TOML files.

`base` has the interfaces and the sum of forces; a force, an actuator or an effect is a module of
its own. Everything is a tree of numbers in SI units that JAX differentiates. Imports nothing of
the library but kinematics, scales, types and errors.
"""
