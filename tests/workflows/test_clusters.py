"""Sweeps and fleets on a cluster: a real scheduler with two workers, which die and fail here."""

import collections
import pathlib
import shutil
import signal
import sys
import time
from typing import Any

import pandas as pd
import pytest
from tests.clusters import LocalProcesses, kill
from tests.faults.commands import write_inputs
from tests.poisoned import ATTEMPTS, DyingOnce, Poisoned, Slow, Watched, poisoned_boat

import diffsea
from diffsea.cli import main
from diffsea.outside import cluster
from diffsea.progress import PartialProgress
from diffsea.studies import parts
from diffsea.workflows import boat_processes


pytestmark = pytest.mark.slow

TRIAL = ["--manoeuvre", "zigzag", "--executes", "2", "--step", "0.1"]
GRID = ["--grid", "mass=-190:230:3", "N_r=-300:60000:2", "I_z=300:3000:2", "--part", "3"]
ALLOWED = 1  # deaths of workers that the scheduler allows a task


@pytest.fixture(scope="module")
def harbour(tmp_path_factory):
    """Recordings, and the manifest of a fleet with a boat that has none."""
    folder = write_inputs(tmp_path_factory.mktemp("harbour") / "inputs")
    rows = ["boat,vessel,recording", "one,boat.toml,run.csv", "other,boat.toml,other.csv"]
    (folder / "fleet.csv").write_text("\n".join([*rows, "ghost,otter,none.csv", ""]))
    return folder


@pytest.fixture(scope="module")
def workers(tmp_path_factory):
    """A cluster of two workers, each started again when it dies."""
    folder = tmp_path_factory.mktemp("cluster")
    environment = {
        ATTEMPTS: str(folder / "attempts"),
        "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": str(ALLOWED),
    }
    with LocalProcesses(folder, environment) as processes:
        for _ in range(2):
            processes.worker("--nanny")
        yield processes


@pytest.fixture
def attempts(workers):
    """How often each task is begun, counted when called."""
    folder = workers.folder / "attempts"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    return lambda: collections.Counter(one.name.rpartition("-")[0] for one in folder.iterdir())


@pytest.fixture(scope="module")
def whole(harbour, tmp_path_factory):
    """The results of a sweep without a cluster."""
    out = tmp_path_factory.mktemp("whole") / "out"
    assert main(sweep_words(harbour, out)) == 0
    return results(out)


def sweep_words(harbour, out, *more):
    return ["sweep", str(harbour / "boat.toml"), *TRIAL, *GRID, "-o", str(out), *more]


def fleet_words(harbour, out, *more):
    return ["fleet", str(harbour / "fleet.csv"), "--until", "audit", "-o", str(out), *more]


def results(folder):
    return {one.name: one.read_bytes() for one in folder.iterdir()}


@pytest.mark.proof
def test_a_sweep_on_a_cluster_has_the_bytes_of_one_without(
    harbour, workers, whole, attempts, tmp_path, monkeypatch
):
    """In shards, and gone on with after a part is lost."""
    monkeypatch.setattr(parts, "PartRunner", Watched)
    words = sweep_words(harbour, tmp_path / "out", "--cluster", workers.address)
    assert main([*words, "--shard", "2/2"]) == 0
    assert attempts() == {"1": 1, "3": 1} and not (tmp_path / "out").exists()
    assert main([*words, "--resume"]) == 0
    assert attempts() == dict.fromkeys("0123", 1)
    assert results(tmp_path / "out") == whole
    (part,) = (tmp_path / "out-parts").glob("*/part-00000002.parquet")
    part.unlink()
    assert main([*words, "--resume"]) == 0
    assert attempts() == {"0": 1, "1": 1, "2": 2, "3": 1}
    assert results(tmp_path / "out") == whole


def test_a_sweep_from_python_takes_a_client_and_tells_how_far_it_is(harbour, workers):
    from distributed import Client

    told = []
    grid = {"mass": (-190, 230, 2), "N_r": (-300, 60000, 2), "I_z": (300, 300, 1)}
    trial = {"grid": grid, "executes": 2, "step": 0.1}
    alone = diffsea.sweep(harbour / "boat.toml", "zigzag", **trial)
    with Client(workers.address, set_as_default=False) as client:
        more = {"cluster": client, "part": 3, "progress": told.append}
        found = diffsea.sweep(harbour / "boat.toml", "zigzag", **trial, **more)
        assert client.status == "running"
    pd.testing.assert_frame_equal(found, alone, check_exact=True)
    shares = [one.share for one in told if isinstance(one, PartialProgress)]
    assert shares == [0.5, 1.0]


@pytest.mark.proof
def test_a_worker_killed_amid_a_sweep_loses_nothing(
    harbour, workers, whole, attempts, tmp_path, monkeypatch
):
    monkeypatch.setattr(parts, "PartRunner", DyingOnce)
    words = sweep_words(harbour, tmp_path / "out", "--cluster", workers.address)
    assert main(words) == 0
    assert attempts() == {"0": 1, "1": 2, "2": 1, "3": 1}
    assert results(tmp_path / "out") == whole


@pytest.mark.proof
def test_a_poisoned_part_is_told_and_all_others_are_kept(
    harbour, workers, whole, attempts, tmp_path, monkeypatch, capsys
):
    """One raises, one kills its workers and is tried again when it is alone."""
    words = sweep_words(harbour, tmp_path / "out", "--cluster", workers.address)
    with monkeypatch.context() as patch:
        patch.setattr(parts, "PartRunner", Poisoned)
        assert main(words) == 1
    told = capsys.readouterr().err
    assert "2 of 4 parts failed" in told and "this is a bug" not in told
    assert "part 1 (designs 3 to 5): ValueError: a design from hell" in told
    assert f"part 2 (designs 6 to 8): {ALLOWED + 1} workers died while they had it" in told
    assert "All others are kept" in told and "the same command goes on" in told
    done = attempts()
    assert (done["1"], done["2"]) == (cluster.RETRIES + 1, 2 * (ALLOWED + 1))
    assert not (tmp_path / "out").exists()
    kept = sorted(one.name for one in (tmp_path / "out-parts").glob("*/part-*"))
    assert kept == ["part-00000000.parquet", "part-00000003.parquet"]
    assert main([*words, "--resume"]) == 0
    assert results(tmp_path / "out") == whole


@pytest.mark.proof
def test_a_fleet_on_a_cluster_is_that_of_one_process_and_goes_on(
    harbour, workers, tmp_path, monkeypatch, capsys
):
    """The manifest is named by a path that is relative to the folder of who asks."""
    monkeypatch.chdir(harbour.parent)
    here, on_cluster = pathlib.Path(harbour.name), ("--cluster", workers.address)
    assert main(fleet_words(here, tmp_path / "alone")) == 0
    assert main(fleet_words(here, tmp_path / "out", *on_cluster)) == 0
    table = pd.read_parquet(tmp_path / "out" / "fleet.parquet")
    assert table["status"].tolist() == ["done", "done", "failed"]
    assert results(tmp_path / "out") == results(tmp_path / "alone")
    assert len(list((tmp_path / "out-parts").iterdir())) == 2
    capsys.readouterr()
    assert main(fleet_words(here, tmp_path / "out", *on_cluster)) == 0
    assert "2 boats were done before" in capsys.readouterr().err


@pytest.mark.proof
def test_a_poisoned_boat_is_a_row_and_one_whose_worker_died_is_done(
    harbour, workers, attempts, monkeypatch
):
    monkeypatch.setattr(boat_processes, "_done_by_worker", poisoned_boat)
    files = [str(harbour / "boat.toml"), str(harbour / "run.csv")]
    rows = [[boat, *files] for boat in ("one", "raises", "kills")]
    manifest = pd.DataFrame(rows, columns=["boat", "vessel", "recording"])
    one, raises, kills = diffsea.fleet(manifest, until="audit", cluster=workers.address).boats
    assert one["status"] == "done" and raises["status"] == kills["status"] == "failed"
    assert raises["reason"].endswith("ValueError: a log from hell")
    assert "workers died while they had it" in kills["reason"]
    assert attempts()["raises"] == cluster.RETRIES + 1
    assert attempts()["one"] >= 2 and attempts()["kills"] == 2 * (ALLOWED + 1)
    assert diffsea.fleet(manifest.head(1), until="audit").boats == [one]


def test_a_boat_whose_process_breaks_down_is_an_error_on_a_worker(tmp_path):
    """So that another one tries, which may have more memory."""
    task = {"boat": "one"}  # of which its process has too little to go by
    with pytest.raises(diffsea.UserError, match="its process broke down.*KeyError"):
        boat_processes._done_by_worker(str(tmp_path), task)


COMMANDS = {"sweep": sweep_words, "fleet": fleet_words}


@pytest.mark.parametrize("command", COMMANDS)
def test_without_a_scheduler_nothing_is_written(command, harbour, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(cluster, "PATIENCE", 0.5)
    words = COMMANDS[command](harbour, tmp_path / "out")
    for address in ("tcp://127.0.0.1:9", "nonsense"):
        assert main([*words, "--cluster", address]) == 1
        told = capsys.readouterr().err
        assert f"no Dask scheduler answers at {address}" in told and "`dask scheduler`" in told
        assert "bug" not in told and not list(tmp_path.iterdir())


@pytest.mark.parametrize("command", COMMANDS)
def test_without_the_extra_nothing_is_written(command, harbour, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "distributed", None)
    words = COMMANDS[command](harbour, tmp_path / "out", "--cluster", "tcp://127.0.0.1:9")
    assert main(words) == 1
    assert "pip install 'diffsea[cluster]'" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("comes", ["before", pytest.param("later", marks=pytest.mark.proof)])
def test_a_worker_of_another_version_is_refused(comes, harbour, tmp_path, monkeypatch, capsys):
    """Whether it is there at the beginning, or comes when that has been looked at."""
    other = tmp_path / "other" / "diffsea-0.0.1.dist-info"
    other.mkdir(parents=True)
    (other / "METADATA").write_text("Metadata-Version: 2.1\nName: diffsea\nVersion: 0.0.1\n")
    if comes == "later":
        monkeypatch.setattr(cluster, "_check_versions", lambda client: None)
    out = tmp_path / "results" / "out"
    out.parent.mkdir()
    with LocalProcesses(tmp_path) as processes:
        processes.worker(paths=[other.parent])
        processes.await_workers(1)
        for words in (sweep_words, fleet_words):
            assert main(words(harbour, out, "--cluster", processes.address)) == 1
            told = capsys.readouterr().err
            assert "has diffsea 0.0.1, here it is" in told and "install the same on all" in told
            assert not out.exists() and not list(out.parent.glob("*/*/part-*"))
    assert comes == "later" or not list(out.parent.iterdir())


def count_tasks(client) -> Any:
    return client.run_on_scheduler(lambda dask_scheduler: len(dask_scheduler.tasks))


@pytest.mark.proof
@pytest.mark.usefixtures("attempts")
def test_a_client_that_is_lent_has_no_task_left_after_an_interrupt(harbour, workers, monkeypatch):
    from distributed import Client

    def interrupt(message):
        if isinstance(message, PartialProgress):
            assert count_tasks(client) > 0
            raise KeyboardInterrupt

    monkeypatch.setattr(parts, "PartRunner", Slow)
    grid = {"mass": (-190, 230, 3), "N_r": (-300, 60000, 2), "I_z": (300, 3000, 2)}
    more = {"executes": 2, "step": 0.1, "part": 3, "progress": interrupt}
    with Client(workers.address, set_as_default=False) as client:
        with pytest.raises(KeyboardInterrupt):
            diffsea.sweep(harbour / "boat.toml", "zigzag", grid=grid, cluster=client, **more)
        assert count_tasks(client) == 0 and client.status == "running"


SLOW = """
import sys
from diffsea.runtime import prepare_jax
prepare_jax()
from diffsea.cli import main
from diffsea.studies import parts
from tests.poisoned import Slow
parts.PartRunner = Slow
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.proof
@pytest.mark.parametrize("ends", ["interrupt", "scheduler"])
def test_what_is_under_way_is_given_up(ends, harbour, tmp_path):
    """By Ctrl-C, after which the scheduler has no task left, or when the scheduler is gone."""
    from distributed import Client

    (tmp_path / "attempts").mkdir()
    with LocalProcesses(tmp_path, {ATTEMPTS: str(tmp_path / "attempts")}) as processes:
        processes.worker()
        words = sweep_words(harbour, tmp_path / "out", "--cluster", processes.address)
        asking = processes.start([sys.executable, "-c", SLOW, *words])
        while not list((tmp_path / "attempts").iterdir()):
            assert asking.poll() is None, processes.logs()
            time.sleep(0.05)
        if ends == "scheduler":
            kill(processes.scheduler)
            assert asking.wait(20) == 1
            told = processes.said(asking)
            assert "the scheduler is gone" in told and "Traceback" not in told
        else:
            with Client(processes.address, set_as_default=False) as client:
                assert count_tasks(client) == 1
                asking.send_signal(signal.SIGINT)
                assert asking.wait(20) == 130 and count_tasks(client) == 0
            assert processes.said(asking).endswith("the same command goes on from there\n")
    assert not (tmp_path / "out").exists()
