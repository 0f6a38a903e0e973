"""Functional mock-up units: a vessel for co-simulation by FMI 3.0, run by PythonFMU3.

The unit holds a simulator in plain Python (`planar_model`) and the vessel's numbers; it needs
neither diffsea nor JAX nor NumPy where it runs, but a Python that PythonFMU3's library finds.
"""

import json
import pathlib
import re
import zipfile

from diffsea.errors import UserError
from diffsea.exports import planar_model
from diffsea.exports.equations import Equations
from diffsea.outside.durable import working_folder


_HERE = pathlib.Path(__file__).parent


def identifier(name: str) -> str:
    """A vessel's name as C and MATLAB allow it: letters, digits and underscores."""
    plain = re.sub(r"\W", "_", name, flags=re.ASCII)
    return plain if plain[:1].isalpha() else f"vessel_{plain}"


def write_fmu(equations: Equations, path: pathlib.Path) -> None:
    """Write a vessel as an FMU 3.0 for co-simulation.

    Inputs `cmd_<channel>` (in the channel's unit), `current_north` and `current_east` (m/s) hold
    over a communication step; parameters `x_start` ... `r_start`; outputs x, y, psi, u, v, r over
    ground and `exec_<channel>`. SI units, NED, rad.

    Raises:
        UserError: PythonFMU3 is not installed.
    """
    try:
        from pythonfmu3 import FmuBuilder
    except ImportError:
        raise UserError(
            "--to fmu needs PythonFMU3; install it with: pip install 'diffsea[fmu]'"
        ) from None
    description = f"{equations.name}, planar motion, by diffsea; {equations.source}"
    table = equations.as_dict() | {
        "identifier": identifier(equations.name),
        "description": description,
    }
    with working_folder() as folder:
        numbers = folder / "equations.json"
        numbers.write_text(json.dumps(table, indent=1), encoding="utf-8")
        built = FmuBuilder.build_FMU(
            _HERE / "vessel_slave.py",
            dest=folder / "built",
            project_files=[numbers, planar_model.__file__],
        )
        content = built.read_bytes()
    path.write_bytes(content)


def platforms(path: pathlib.Path) -> list[str]:
    """The platforms whose library a unit holds, as FMI names them."""
    with zipfile.ZipFile(path) as unit:
        names = [pathlib.PurePosixPath(name).parts for name in unit.namelist()]
    return sorted({parts[1] for parts in names if parts[0] == "binaries" and len(parts) > 2})
