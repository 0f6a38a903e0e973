"""The slave of a functional mock-up unit: a vessel in FMI's words, with its numbers beside it.

This file goes as it is into the unit, next to `planar_model.py`, `equations.json` and the copy of
PythonFMU3 that its builder puts there; nothing in diffsea imports it.
"""

import json
import pathlib

from planar_model import STATES, PlanarVessel  # pyright: ignore[reportMissingImports]
from pythonfmu3 import (  # pyright: ignore[reportMissingImports]
    Float64,
    Fmi3Causality,
    Fmi3Initial,
    Fmi3Slave,
    Fmi3StepResult,
    Fmi3Variability,
)


class VesselSlave(Fmi3Slave):
    """Orders and a current in, position and motion over ground out; SI units, NED, rad."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        path = pathlib.Path(self.resources or pathlib.Path(__file__).parent) / "equations.json"
        self.equations = json.loads(path.read_text(encoding="utf-8"))
        self.modelName = self.equations["identifier"]
        self.description = self.equations["description"]
        self.values = {"current_north": self.equations["current"][0]}
        self.values["current_east"] = self.equations["current"][1]
        self.values |= {f"{name}_start": 0.0 for name in STATES}
        self.values |= {f"cmd_{c['name']}": c["neutral"] for c in self.equations["channels"]}
        self.outputs = {}
        self.exit_initialization_mode()
        self.time = 0.0
        time = {"causality": Fmi3Causality.independent, "variability": Fmi3Variability.continuous}
        self.register_variable(Float64("time", **time))
        for name in self.values:
            given = {"causality": Fmi3Causality.input}
            if name.endswith("_start"):
                fixed = {"variability": Fmi3Variability.fixed}
                given = {"causality": Fmi3Causality.parameter} | fixed
            self._register(name, self.values, given)
        made = {"causality": Fmi3Causality.output, "initial": Fmi3Initial.calculated}
        for name in self.outputs:
            self._register(name, self.outputs, made)

    def _register(self, name, table, attributes):
        """A variable whose value lies in a table, which outlives every change of it."""

        def put(value):
            table[name] = value

        variable = Float64(name, getter=lambda: table[name], setter=put, **attributes)
        self.register_variable(variable, nested=False)

    def exit_initialization_mode(self):
        """Start where the parameters say, actuators settled to their orders."""
        state = [self.values[f"{name}_start"] for name in STATES]
        self.vessel = PlanarVessel(self.equations, state, self._orders())
        self._tell()

    def do_step(self, current_time, step_size):
        """Move on, the inputs held."""
        current = (self.values["current_north"], self.values["current_east"])
        self.vessel.advance(current_time, step_size, self._orders(), current)
        self._tell()
        self.time = current_time + step_size
        return Fmi3StepResult()

    def _orders(self):
        return {c["name"]: self.values[f"cmd_{c['name']}"] for c in self.equations["channels"]}

    def _tell(self):
        self.outputs.update(zip(STATES, self.vessel.state, strict=True))
        self.outputs.update({f"exec_{name}": v for name, v in self.vessel.executed.items()})
