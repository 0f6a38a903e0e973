"""The real sets: vessel, mapping, what is fitted and what is held out, one record each.

Recordings are read through the public door and become tables; clocks begin at zero. A set with
measured actuation has a second record, with `-orders`, in which that is given as orders.
"""

import copy
import dataclasses
import math
import tomllib
from collections.abc import Callable
from pathlib import Path

from experiments.check_data import absent, data_folder
from experiments.concealed_real import logs
from experiments.concealed_real.material import Document, Material, Run, Runs

import numpy as np
import pandas as pd

import diffsea


ROOT = Path(__file__).resolve().parents[2]
DATA = data_folder()  # not part of the project
EXPERIMENTS = ROOT / "experiments"

Span = tuple[float, float]  # from, to: s after the first row


@dataclasses.dataclass(frozen=True)
class RealSet:
    """One set of recordings.

    Arguments:
        read: all runs by file name, as they are believed after the audit.
        vessel: name of a shipped vessel, or path of a file.
        spans: the part that is used, of runs that are not used whole.
        develop: looked at while the tool is made; the others are looked at only to report.
    """

    read: Callable[[], Runs]
    vessel: str
    train: tuple[str, ...]
    held_out: tuple[str, ...]
    per_recording: bool = False
    spans: dict[str, Span] = dataclasses.field(default_factory=dict)
    develop: bool = False
    adapt: Callable[[Document], Document] = lambda document: document

    def load(self) -> Material:
        """Vessel and recordings; raises FileNotFoundError where the data are absent."""
        runs = self.read()
        used = lambda names: {name: self._part(name, runs[name]) for name in names}
        document = self.adapt(document_of(self.vessel))
        return Material(document, used(self.train), used(self.held_out), self.per_recording)

    def _part(self, name: str, run: Run) -> Run:
        first, last = self.spans.get(name, (0.0, math.inf))
        t = run["t"].to_numpy() - run["t"].to_numpy()[0]
        chosen = np.flatnonzero((t >= first) & (t <= last))
        part = run.iloc[chosen].reset_index(drop=True)
        return part.assign(t=t[chosen] - t[chosen[0]])


def document_of(vessel: str) -> Document:
    """The content of a vessel file."""
    if vessel.endswith(".toml"):
        return tomllib.loads(Path(vessel).read_text(encoding="utf-8"))
    return copy.deepcopy(diffsea.read_vessel(vessel).document)


def available() -> bool:
    """Whether the real data lie beside the repository."""
    return DATA.is_dir()


def tables(pattern: str, mapping: Path, earth: tuple[str, ...] = ()) -> Runs:
    """All files of a pattern under the data through a mapping, as tables with native columns.

    Arguments:
        earth: files whose velocities are in earth axes, whatever the mapping says.
    """
    files = sorted(DATA.glob(pattern))
    if not files:
        raise FileNotFoundError(absent(pattern))
    usual = diffsea.read_mapping(mapping)
    turned = dataclasses.replace(usual, velocity_axes="earth")
    of = lambda file: turned if file.name in earth else usual
    return {file.name: table_of(diffsea.read_recording(file, of(file))) for file in files}


def table_of(run: diffsea.Trajectory) -> Run:
    """A recording as a table with native columns; channels without any value are left out."""
    columns = run.motion | {f"cmd_{name}": values for name, values in run.commanded.items()}
    columns |= {f"exec_{name}": values for name, values in run.executed.items()} | run.extra
    known = {name: values for name, values in columns.items() if np.any(np.isfinite(values))}
    return pd.DataFrame({"t": run.t} | known)


def as_orders(runs: Runs) -> Runs:
    """Measured actuation as if it were orders, and no measured actuation."""
    rename = lambda c: c.replace("exec_", "cmd_", 1) if c.startswith("exec_") else c
    return {
        name: run.drop(columns=[c for c in run if c.startswith("cmd_")]).rename(columns=rename)
        for name, run in runs.items()
    }


def without_rate_limit(document: Document) -> Document:
    """A vessel whose rudder follows orders at once: orders that a rudder has followed already."""
    new = copy.deepcopy(document)
    for rudder in new.get("rudder", []):
        rudder.pop("rate_limit", None)
    return new


# Each set


def hsva(mapping: str = "mapping_repaired.toml") -> Runs:
    """KVLCC2 in the basin: eight zig-zags, rudder and revolutions measured."""
    return tables("kvlcc2_hsva/*.dat", EXPERIMENTS / "kvlcc2_hsva" / mapping)


def kcs() -> Runs:
    """KCS in the basin: three zig-zags with heel."""
    return tables("kcs_marin/*.txt", EXPERIMENTS / "kcs_marin" / "mapping.toml")


def blueboat(mapping: str = "mapping_repaired.toml") -> Runs:
    """Field runs of a twin-thruster craft."""
    return tables("blueboat/*.csv", EXPERIMENTS / "blueboat" / mapping)


def esso(mapping: str = "mapping_repaired.toml") -> Runs:
    """A tanker model on a pond; the measured wind is not read."""
    return tables("esso_osaka/recordings/*.csv", EXPERIMENTS / "esso_osaka" / mapping)


_VTEC = "mpc_guidance_exp{}__vn_2021-06-{}.csv"
VTEC_EARTH = tuple(
    _VTEC.format(0, f"08-{time}")
    for time in ("14-52-21", "14-53-56", "14-56-54", "15-03-45", "15-07-40")
)


def vtec(repaired: bool = True) -> Runs:
    """A twin-thruster craft in closed loop on a lake; five runs have velocities in earth axes."""
    earth = VTEC_EARTH if repaired else ()
    return tables("vtec_s3_2021/*.csv", DATA / "vtec_s3_2021" / "mapping.toml", earth)


MILLIAMPERE = ("nlp1", "qp1", "maneuvering1")


def milliampere(feedback: bool = True) -> Runs:
    """A ferry with four azimuth thrusters, station keeping."""
    folder = DATA / "milliampere1_2025"
    return {f"{n}.csv": logs.milliampere(folder / n, feedback) for n in MILLIAMPERE}


def kingfisher() -> Runs:
    """Steps of a catamaran straight ahead."""
    return logs.kingfisher(DATA / "kingfisher_nps_2017")


_Z = "HSVA_CPMC_KVLCC2_Z_{}.dat".format
_KCS = "SIMMAN2020_container_KCS_MARIN_zigzag_{}_FS.txt".format
_BOAT = "fixed_00000{}.csv".format
_ESSO_SPANS = {  # turns without the acceleration by hand
    "zigzag_31-Jul-2020_13_04_24.csv": (0.0, 120.0),
    "zigzag_31-Jul-2020_13_22_52.csv": (0.0, 120.0),
    "zigzag_31-Jul-2020_14_03_39.csv": (0.0, 120.0),
    "turn_14-Sep-2020_13_51_45.csv": (100.0, 300.0),
    "random_06-Aug-2020_16_24_25_4.csv": (0.0, 120.0),
    "zigzag_31-Jul-2020_13_42_53.csv": (0.0, 150.0),
    "turn_14-Oct-2020_14_56_07.csv": (100.0, 300.0),
}

_HSVA = RealSet(
    hsva, "kvlcc2", (_Z("10_10_P"), _Z("20_10_S"), _Z("20_05")), (_Z("10_10_S"), _Z("25_05")),
    develop=True,
)  # fmt: skip
_MARIN = RealSet(
    kcs, str(EXPERIMENTS / "real_fits" / "kcs.toml"), (_KCS("port_20"), _KCS("star_10")),
    (_KCS("port_10"),), develop=True,
)  # fmt: skip
_FERRY = RealSet(
    milliampere, str(DATA / "milliampere1_2025" / "vessel.toml"), ("nlp1.csv", "maneuvering1.csv"),
    ("qp1.csv",), per_recording=True, spans={"nlp1.csv": (0.0, 300.0), "qp1.csv": (0.0, 240.0)},
    develop=True,
)  # fmt: skip

SETS: dict[str, RealSet] = {
    "hsva": _HSVA,
    "hsva-orders": dataclasses.replace(
        _HSVA, read=lambda: as_orders(hsva()), adapt=without_rate_limit
    ),
    "kcs": _MARIN,
    "kcs-orders": dataclasses.replace(
        _MARIN, read=lambda: as_orders(kcs()), adapt=without_rate_limit
    ),
    "blueboat": RealSet(
        blueboat, "blueboat", tuple(map(_BOAT, (218, 223, 226, 230))),
        tuple(map(_BOAT, (228, 232))), per_recording=True, develop=True,
    ),
    "esso": RealSet(
        esso, "esso_osaka", tuple(_ESSO_SPANS)[:5], tuple(_ESSO_SPANS)[5:], per_recording=True,
        spans=_ESSO_SPANS, develop=True,
    ),
    "vtec": RealSet(
        vtec, str(DATA / "vtec_s3_2021" / "vessel.toml"),
        (_VTEC.format(0, "08-14-56-54"), _VTEC.format(0, "08-15-17-05"),
         _VTEC.format(0, "11-12-30-52"), _VTEC.format(1, "08-18-28-46"),
         _VTEC.format(4, "11-13-22-46"), _VTEC.format(4, "11-13-34-12")),
        (_VTEC.format(0, "11-12-27-02"), _VTEC.format(2, "11-18-18-35"),
         _VTEC.format(4, "11-13-40-21")),
        per_recording=True,
    ),
    "milliampere": _FERRY,
    "milliampere-orders": dataclasses.replace(_FERRY, read=lambda: milliampere(False)),
    "kingfisher": RealSet(
        kingfisher, str(DATA / "kingfisher_nps_2017" / "vessel.toml"),
        tuple(f"step_{n}.csv" for n in ("090_1818", "080_1272", "070_917", "050_514", "030_272",
                                         "010_49")),
        tuple(f"step_{n}.csv" for n in ("100_2019", "060_745", "040_403", "020_176")),
        develop=True,
    ),
}  # fmt: skip
