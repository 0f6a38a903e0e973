"""A warm process whose children read hostile inputs, so that an input takes milliseconds.

A child reads some inputs, one after the other, because a fork takes as long as a refusal; the one
that ends it, or leaves it large, is its last.

Reads lines of JSON from standard input: `kind`, `command`, `file` and a folder `out`. Answers
each by a line: `status` (of the exit; negative for a signal), `said` (all that the child printed),
`megabytes` (largest resident memory) and `left` (what it wrote although it failed).
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
INPUTS_OF_A_CHILD = 50
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
COMMANDS = ("metrics", "audit", "check")  # that read recordings
# Read without a command.
DOCUMENTS = ("vessel", "priors", "sheet", "fit", "mission", "battery", "manifest")
SIZE = "200MB"  # to which files may expand here


def _command(kind, name, file, out):
    """Words of the command of a name that reads a file of a kind."""
    words = [name, str(file), "-o", str(out), "--max-size", SIZE]
    if kind == "mapping":
        return [name, str(SUPPORT["good.csv"]), "-o", str(out), "--mapping", str(file)]
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
    """Each command on a valid file, which imports what commands import while they run."""
    said = [os.dup(number) for number in (1, 2)]
    with open(os.devnull, "wb") as nowhere:
        for number in (1, 2):
            os.dup2(nowhere.fileno(), number)
        statuses = [_run("csv", one, SUPPORT["good.csv"], folder / one) for one in COMMANDS]
    for number, own in zip((1, 2), said, strict=True):
        os.dup2(own, number)
        os.close(own)
    assert not any(statuses), statuses


def _run(kind, command, file, out):
    """The status with which a command that reads a file ends, as the command line has it."""
    from diffsea import cli
    from diffsea.errors import UserError
    from diffsea.outside.printable import printable

    if kind not in DOCUMENTS:
        return cli.main(_command(kind, command, file, out))
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


class Reader:
    """A child that is forked anew once it ended, grew large or has read enough."""

    def __init__(self, printed):
        self._printed = printed  # file that takes what children print
        self._child = 0

    def judge(self, kind, command, file, out):
        """Have an input read, wait, and say how it ended."""
        if not self._child:
            self._fork()
        self._printed.seek(0)
        self._printed.truncate()
        began = time.monotonic()
        self._asked.write(json.dumps([kind, command, str(file), str(out)]) + "\n")
        self._asked.flush()
        answer = self._answers.readline()
        if answer:
            status, megabytes = json.loads(answer)
        else:
            _, ended, used = os.wait4(self._child, 0)
            status, megabytes = os.waitstatus_to_exitcode(ended), used.ru_maxrss / 1e3
        self._printed.seek(0)
        said = self._printed.read().decode(errors="surrogateescape")
        left = sorted(str(item.name) for item in out.rglob("*")) if out.exists() else []
        shutil.rmtree(out, ignore_errors=True)
        self._inputs += 1
        if not answer:
            self._forget()
        elif self._inputs == INPUTS_OF_A_CHILD or megabytes > MEGABYTES / 2:
            self.close()
        return {
            "status": status,
            "said": said if len(said) < 8000 else said[:4000] + said[-4000:],
            "megabytes": megabytes,
            "seconds": time.monotonic() - began,
            "left": left if status != 0 else [],
        }

    def _fork(self):
        asked, answers = os.pipe(), os.pipe()
        self._child, self._inputs = os.fork(), 0
        if self._child == 0:
            os.close(asked[1])
            os.close(answers[0])
            try:
                _serve(os.fdopen(asked[0]), os.fdopen(answers[1], "w"), self._printed.fileno())
            finally:
                os._exit(99)
        os.close(asked[0])
        os.close(answers[1])
        self._asked, self._answers = os.fdopen(asked[1], "w"), os.fdopen(answers[0])

    def _forget(self):
        self._asked.close()
        self._answers.close()
        self._child = 0

    def close(self):
        """End the child, which has nothing under way."""
        if self._child:
            child = self._child
            self._forget()
            os.waitpid(child, 0)


def _serve(asked, answers, printed):
    """What a child does until nothing more is asked."""
    for number in (1, 2):
        os.dup2(printed, number)
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESSES, ADDRESSES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    warnings.simplefilter("ignore")
    own = pathlib.Path("/proc/self")
    for line in asked:
        kind, command, file, out = json.loads(line)
        (own / "clear_refs").write_text("5")  # the largest memory counts anew
        signal.setitimer(signal.ITIMER_REAL, SECONDS)
        status = _run(kind, command, pathlib.Path(file), pathlib.Path(out))
        signal.setitimer(signal.ITIMER_REAL, 0)
        sys.stdout.flush()
        sys.stderr.flush()
        words = (own / "status").read_text().split()
        megabytes = int(words[words.index("VmHWM:") + 1]) * 1.024e-3
        answers.write(json.dumps([status, megabytes]) + "\n")
        answers.flush()
    os._exit(0)


def main():
    for name in LOADED:
        importlib.import_module(name)
    folder = pathlib.Path(tempfile.mkdtemp())
    write_support(folder)
    BOAT[:] = _boat()
    _warm(folder)
    print(json.dumps("ready"), flush=True)
    with tempfile.TemporaryFile() as printed:
        reader = Reader(printed)
        for line in sys.stdin:
            asked = json.loads(line)
            file, out = pathlib.Path(asked["file"]), pathlib.Path(asked["out"])
            answer = reader.judge(asked["kind"], asked["command"], file, out)
            print(json.dumps(answer), flush=True)
        reader.close()
    shutil.rmtree(folder)


if __name__ == "__main__":
    main()
