"""A warm process that forks one child for each hostile input, so that an input takes milliseconds.

Reads lines of JSON from standard input: `kind`, `file` and a folder `out`. Answers each by a line:
`status` (of the exit; negative for a signal), `said` (all that the child printed), `megabytes`
(largest resident memory) and `left` (what it wrote although it failed).
"""

import importlib
import json
import os
import pathlib
import pickle
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings

from tests.fuzz.seeds import SUPPORT, write_support


SECONDS = 20.0
MEGABYTES = 2000.0
ADDRESSES = 6_000_000_000  # bytes: a bound so that a bomb does not take the machine along
# What children would else import anew for each input; the rest comes with a first command.
LOADED = (
    "diffsea.exports.ardupilot",
    "diffsea.identification.objectives.trial_numbers",
    "diffsea.missions.document",
    "diffsea.missions.studies.battery",
    "diffsea.workflows.manifest",
    "mcap.reader",
    "pyarrow.parquet",
    "pymavlink.DFReader",
    "pymavlink.mavutil",
    "pyulog",
    "rosbags.highlevel",
    "scipy.io",
)
BOAT = []  # vessel and priors
# Read without a command.
DOCUMENTS = ("vessel", "priors", "sheet", "fit", "mission", "battery", "manifest")
SIZE = "200MB"  # to which files may expand here


def _command(kind, file, out):
    """Words of the command that reads a file of a kind."""
    words = ["metrics", str(file), "-o", str(out), "--max-size", SIZE]
    if kind == "mapping":
        return ["metrics", str(SUPPORT["good.csv"]), "-o", str(out), "--mapping", str(file)]
    if kind == "mat":
        return [*words, "--mapping", str(SUPPORT["mat.toml"])]
    return words


def _boat():
    """The vessel that priors and sheets are of, and its priors, from a process of its own.

    Numbers of JAX would start its threads, which no child that is forked then has.
    """
    program = (
        "import pickle, sys, jax, numpy as np\n"
        "from diffsea.vessel.files import default_priors, read_vessel\n"
        "vessel = read_vessel(sys.argv[1]).vessel\n"
        "made = jax.tree.map(np.asarray, vessel), default_priors(vessel)\n"
        "sys.stdout.buffer.write(pickle.dumps(made))\n"
    )
    command = [sys.executable, "-c", program, str(SUPPORT["boat.toml"])]
    return pickle.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)


def _read_document(kind, file):
    """Read a document; these need no command's computing."""
    from diffsea.identification.objectives.trial_numbers import read_trial_table
    from diffsea.missions.document import read_mission
    from diffsea.missions.studies.battery import read_battery
    from diffsea.outside.documents import read_json
    from diffsea.parameters import read_priors
    from diffsea.vessel.files import read_vessel
    from diffsea.workflows.manifest import read_manifest

    vessel, priors = BOAT
    if kind == "vessel":
        read_vessel(file)
    elif kind == "mission":
        read_mission(file)
    elif kind == "battery":
        read_battery(file)
    elif kind == "manifest":
        read_manifest(file)
    elif kind == "priors":
        read_priors(file, priors)
    elif kind == "sheet":
        read_trial_table(file, vessel)
    else:
        from diffsea.errors import UserError
        from diffsea.exports.ardupilot import rows_of_fit

        content = read_json(file, "the fit")
        if not isinstance(content, dict):
            raise UserError(f"{file} is no fit.json")
        rows_of_fit(content)


def _warm(folder):
    """A command on a valid file, which imports what commands import while they run."""
    said = [os.dup(number) for number in (1, 2)]
    with open(os.devnull, "wb") as nowhere:
        for number in (1, 2):
            os.dup2(nowhere.fileno(), number)
        status = _run("csv", SUPPORT["good.csv"], folder / "warm")
    for number, own in zip((1, 2), said, strict=True):
        os.dup2(own, number)
        os.close(own)
    assert status == 0, status


def _run(kind, file, out):
    """The status with which reading a file ends, as the command line has it."""
    from diffsea import cli
    from diffsea.errors import UserError
    from diffsea.outside.printable import printable

    if kind not in DOCUMENTS:
        return cli.main(_command(kind, file, out))
    try:
        _read_document(kind, file)
    except UserError as error:
        print(printable(f"diffsea: error: {error}"), file=sys.stderr)
        return 1
    except Exception as error:
        print(f"this is a bug: {type(error).__name__}: {error}", file=sys.stderr)
        print(traceback.format_exc(limit=-3).replace("Traceback", "trace"), file=sys.stderr)
        return 1
    return 0


def judge(kind, file, out):
    """Fork, run, wait, and say how it ended."""
    with tempfile.TemporaryFile() as printed:
        child = os.fork()
        if child == 0:
            status = 99
            try:
                os.dup2(printed.fileno(), 1)
                os.dup2(printed.fileno(), 2)
                resource.setrlimit(resource.RLIMIT_AS, (ADDRESSES, ADDRESSES))
                resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
                signal.signal(signal.SIGALRM, signal.SIG_DFL)
                signal.setitimer(signal.ITIMER_REAL, SECONDS)
                warnings.simplefilter("ignore")
                status = _run(kind, file, out)
                sys.stdout.flush()
                sys.stderr.flush()
            finally:
                os._exit(status)
        began = time.monotonic()
        _, ended, used = os.wait4(child, 0)
        printed.seek(0)
        said = printed.read().decode(errors="surrogateescape")
    status = os.waitstatus_to_exitcode(ended)
    left = sorted(str(item.name) for item in out.rglob("*")) if out.exists() else []
    shutil.rmtree(out, ignore_errors=True)
    return {
        "status": status,
        "said": said if len(said) < 8000 else said[:4000] + said[-4000:],
        "megabytes": used.ru_maxrss / 1e3,
        "seconds": time.monotonic() - began,
        "left": left if status != 0 else [],
    }


def main():
    for name in LOADED:
        importlib.import_module(name)
    folder = pathlib.Path(tempfile.mkdtemp())
    write_support(folder)
    BOAT[:] = _boat()
    _warm(folder)
    print(json.dumps("ready"), flush=True)
    for line in sys.stdin:
        asked = json.loads(line)
        found = judge(asked["kind"], pathlib.Path(asked["file"]), pathlib.Path(asked["out"]))
        print(json.dumps(found), flush=True)
    shutil.rmtree(folder)


if __name__ == "__main__":
    main()
