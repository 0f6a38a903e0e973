"""Every command on inputs of seconds, what takes long done once and remembered."""

import contextlib
import functools
import importlib
import io
import math
import os
import pathlib
import shutil
import tempfile
import types
from unittest import mock

from tests.boats import BOAT

from diffsea.cli import main
from diffsea.workflows import boat, boat_processes


MISSION = """
[vessel]
name = "otter"

[controller]
kind = "line-of-sight"
limits = { port = [-6.0, 12.0] }

[[waypoint]]
x = 0.0
y = 0.0

[[waypoint]]
x = 10.0
y = 0.0
"""
BATTERY = """
runs = 2

[vessel]
mass = [65.0, 70.0]
"""
ZIGZAG = ("--manoeuvre", "zigzag", "--executes", "2", "--step", "0.1")

# What takes long, by the name under which commands find it.
REMEMBERED = (
    "diffsea.studies.sensitivity.sensitivities",
    "diffsea.workflows.fits.fit",
    "diffsea.workflows.diagnoses.diagnose",
    "diffsea.workflows.campaigns.campaign",
    "diffsea.workflows.missions.run_mission",
    "diffsea.workflows.missions.run_battery",
    "diffsea.workflows.online.online",
    "diffsea.workflows.metamodel.metamodel",
)


def commands(inputs, out):
    """The words of every command, by name; results go to the folder `out`."""
    boat, run, other = inputs / "boat.toml", inputs / "run.csv", inputs / "other.csv"
    fits = (boat, run, "--test", other, "--free", "X_u,N_r")
    mission = inputs / "mission.toml"
    words = {
        "trial": ("trial", boat, *ZIGZAG),
        "campaign": ("campaign", boat, "--trials", "zigzag:20/20", "--step", "0.1"),
        "metrics": ("metrics", run, "--length", "4"),
        "audit": ("audit", run, other),
        "audit --repair": ("audit", run, "--repair"),
        "audit of a foreign table": ("audit", inputs / "foreign.csv"),
        "check": ("check", run),
        "predict": ("predict", boat, run),
        "segment": ("segment", run),
        "segment --format parquet": ("segment", run, "--format", "parquet"),
        "sensitivity": ("sensitivity", boat, *ZIGZAG, "--parameters", "N_r"),
        "sweep": ("sweep", boat, *ZIGZAG, "--grid", "mass=180:220:2", "N_r=-400:-200:2"),
        "run": ("run", mission),
        "run --battery": ("run", mission, "--battery", inputs / "battery.toml"),
        "online": ("online", boat, run, "--free", "X_u,N_r"),
        "fit": ("fit", *fits),
        "diagnose": ("diagnose", *fits, "--next-manoeuvre", inputs / "next" / "next.csv"),
        "fleet": ("fleet", inputs / "fleet.csv", "--until", "audit"),
        "export --to gazebo": ("export", boat, "--to", "gazebo", "--allow-loss"),
        "export --to ardupilot": ("export", boat, "--to", "ardupilot", "--allow-loss"),
        "export --to fmu": ("export", boat, "--to", "fmu", "--allow-loss"),
        "export --to mss": ("export", boat, "--to", "mss", "--allow-loss"),
    }
    words = {name: (*some, "-o", out) for name, some in words.items()}
    new = ("new", inputs / "next" / "new.toml", "--length", "1.4", "--beam", "0.9", "--mass", "22")
    words |= {"new": (*new, "--force"), "show": ("show", boat), "vessels": ("vessels",)}
    return {name: [str(word) for word in some] for name, some in words.items()}


def write_inputs(folder):
    """What the commands read."""

    (folder / "next").mkdir(parents=True)
    (folder / "boat.toml").write_text(BOAT)
    (folder / "mission.toml").write_text(MISSION)
    (folder / "battery.toml").write_text(BATTERY)
    told = io.StringIO()
    with contextlib.redirect_stdout(told), contextlib.redirect_stderr(told):
        trial = ["trial", str(folder / "boat.toml"), *ZIGZAG]
        for name, side in (("run", "starboard"), ("other", "port")):
            assert main([*trial, "--side", side, "-o", str(folder / name)]) == 0, told.getvalue()
            shutil.move(folder / name / "recording.csv", folder / f"{name}.csv")
            shutil.rmtree(folder / name)
    import pandas as pd

    run = pd.read_csv(folder / "run.csv")
    foreign = pd.DataFrame({"time_s": run["t"], "yaw_deg": run["psi"] * 180 / math.pi})
    foreign["speed_u"], foreign["rate_r"] = run["u"], run["r"]
    foreign.to_csv(folder / "foreign.csv", index=False, sep=";")
    (folder / "fleet.csv").write_text("boat,vessel,recording\none,boat.toml,run.csv\n")
    return folder


@contextlib.contextmanager
def remembered():
    """Within it, what takes long is done once for all commands, whatever it is asked."""
    with contextlib.ExitStack() as patches:
        for name in REMEMBERED:
            module, _, function = name.rpartition(".")
            found = importlib.import_module(module)
            once = _once(getattr(found, function))
            patches.enter_context(mock.patch.object(found, function, once))
        processes = types.SimpleNamespace(Popen=_InProcess, DEVNULL=None)
        patches.enter_context(mock.patch.object(boat_processes, "subprocess", processes))
        study = mock.patch.object(boat, "study_boat", _once(boat.study_boat))
        patches.enter_context(study)
        yield


class _InProcess:
    """The process of a boat of a fleet, as a call."""

    def __init__(self, words, stdout, **_):
        self.status = 0
        try:
            boat.main(*words[-2:])
        except SystemExit as ended:
            stdout.write(str(ended).encode())
            self.status = 1

    def poll(self):
        return self.status

    wait = terminate = poll


def _once(function):
    results = {}

    @functools.wraps(function)
    def done(*args, **kwargs):
        if "result" not in results:
            results["result"] = function(*args, **kwargs)
        return results["result"]

    return done


def ended(words):
    """Status of a command, and what it said on standard error."""
    said, printed = io.StringIO(), io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(printed):
        status = main(words)
    return status, said.getvalue()


def contents(*folders):
    """Every file and folder below some, with its content; None for a folder."""
    return {
        str(path): path.read_bytes() if path.is_file() else None
        for folder in folders
        for path in sorted(pathlib.Path(folder).rglob("*"))
    }


@contextlib.contextmanager
def temporary_files(folder):
    """Within it, files for a while are made in a folder."""
    folder.mkdir(exist_ok=True)
    with (
        mock.patch.object(tempfile, "tempdir", str(folder)),
        mock.patch.dict(os.environ, {"TMPDIR": str(folder)}),
    ):
        yield
