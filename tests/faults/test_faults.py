"""Each call that a command makes for its files fails once: all or nothing, and told."""

import errno
import os
import pathlib
import signal
import subprocess
import sys

import pytest
from tests.faults.calls import Calls
from tests.faults.commands import commands, contents, ended, remembered, write_inputs
from tests.faults.trying import ERRORS, Trial

from diffsea.cli.outputs import Outputs
from diffsea.errors import UserError
from diffsea.outside.unfinished import PREFIX, unfinished_folder


pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("own_cache")]
LONG = (
    *(
        "trial",
        "fit",
        "sweep",
        "sensitivity",
        "predict",
        "diagnose",
        "segment",
        "segment --format parquet",
    ),
    *("online", "campaign", "show"),
)
NAMES = [
    pytest.param(name, marks=[pytest.mark.proof] if name in LONG else [])
    for name in commands(pathlib.Path("in"), pathlib.Path("out"))
]


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    with remembered():
        yield write_inputs(tmp_path_factory.mktemp("faults") / "inputs")


@pytest.mark.parametrize("name", NAMES)
def test_a_call_that_fails_leaves_the_old_results_and_is_told_with_its_path(name, inputs, tmp_path):
    """One call of each kind here; each call with each error in `python -m tests.faults.run`."""
    trial = Trial(name, inputs, tmp_path / "work")
    assert trial.calls
    breaches = [trial.breach(number, ERRORS[number % len(ERRORS)]) for number in trial.chosen()]
    assert not [one for one in breaches if one]


def test_without_earlier_results_nothing_is_left_not_even_the_folder(inputs, tmp_path):
    trial = Trial("metrics", inputs, tmp_path / "work")
    for number in trial.chosen():
        assert not trial.breach(number, errno.ENOSPC, fresh=True)


def test_several_results_take_their_places_together_or_not_at_all(tmp_path):
    names, elsewhere = ("a.txt", "b.txt", "c.txt"), tmp_path / "elsewhere.txt"

    def written(calls):
        with calls.watched(), Outputs(tmp_path / "out") as out:
            for name in names:
                out.text(name, "new")
            out.elsewhere(elsewhere, "--file").write_text("new")

    written(calls := Calls([tmp_path]))
    replaced = [k for k, call in enumerate(calls.made) if call.name == "replace"]
    assert len(replaced) == 4
    for place in (*(tmp_path / "out" / name for name in names[1:]), elsewhere):
        place.write_text("old")
    (tmp_path / "out" / "a.txt").unlink()
    before = contents(tmp_path)
    for number in replaced:
        with pytest.raises(UserError, match="Input/output error"):
            written(Calls([tmp_path], number, errno.EIO))
        assert contents(tmp_path) == before


@pytest.mark.parametrize("name", ["open", "fsync", "replace"])
def test_a_call_that_a_signal_interrupts_is_made_again(name, tmp_path, monkeypatch):
    real, made = getattr(os, name), []

    def interrupted_first(*args, **kwargs):
        made.append(args)
        if len(made) % 2:
            raise InterruptedError(errno.EINTR, os.strerror(errno.EINTR))
        return real(*args, **kwargs)

    with Outputs(tmp_path / "out") as out:
        out.text("a.txt", "a")
        target, beside = tmp_path / "out" / "b.txt", out.text("b.txt", "b")
        monkeypatch.setattr(os, name, interrupted_first)
        out._finish()
        monkeypatch.undo()
        assert target.read_text() == "b" and not beside.exists() and len(made) > 1
        out.files.clear()


def test_a_storm_of_signals_changes_no_result(inputs, tmp_path):
    """Python makes calls again that signals interrupt, and so does what writes tables."""
    told, words = [], commands(inputs, tmp_path / "calm")["segment --format parquet"]
    assert ended(words)[0] == 0
    before = signal.signal(signal.SIGALRM, lambda *_: told.append(1))
    signal.setitimer(signal.ITIMER_REAL, 1e-3, 1e-3)
    try:
        status, said = ended([*words[:-1], str(tmp_path / "storm")])
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    assert status == 0, said
    calm, storm = (
        {pathlib.Path(path).name: content for path, content in contents(tmp_path / name).items()}
        for name in ("calm", "storm")
    )
    assert calm == storm and len(told) > 50


def test_what_a_killed_process_left_is_cleared_and_what_another_writes_is_not(tmp_path):
    killed = (
        "import os, pathlib, sys\n"
        "from diffsea.outside.unfinished import unfinished_folder as made\n"
        "with made(pathlib.Path(sys.argv[1])) as folder: (folder / 'a').touch(); os._exit(0)"
    )
    subprocess.run([sys.executable, "-c", killed, str(tmp_path)], check=True)
    assert len(list(tmp_path.glob(f"{PREFIX}*"))) == 1
    with unfinished_folder(tmp_path) as mine:
        assert list(tmp_path.iterdir()) == [mine]
        with unfinished_folder(tmp_path) as other:
            assert {mine, other} == set(tmp_path.iterdir())
    assert not list(tmp_path.iterdir())


def test_standard_output_that_is_full_is_told():
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "diffsea", "vessels"],
            stdout=full, stderr=subprocess.PIPE, text=True, check=False,
        )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr.strip() == (
        "diffsea: error: cannot write to standard output: No space left on device"
    )
