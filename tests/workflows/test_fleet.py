"""`diffsea fleet` on boats of the independent simulator: what each conceals is known."""

import json
import shutil

import numpy as np
import pandas as pd
import pytest
from tests.oracle.make_recordings import produce
from tests.oracle.simulator import load
from tests.paths import ORACLE

import diffsea
from diffsea.cli import main
from diffsea.workflows import boat_processes


pytestmark = pytest.mark.slow


DRIFT = {"current": {"speed": 0.4, "direction": 1.0}}
BOATS = {"sound": None, "adrift": DRIFT, "torn": None}
RUNS = {"zigzag-fast": "train", "random-fast": "train", "zigzag-slow": "test"}


@pytest.fixture(scope="module")
def harbour(tmp_path_factory):
    """A manifest of three boats, one of them with a broken log, and of one without any log."""
    folder = tmp_path_factory.mktemp("harbour")
    shutil.copy(ORACLE / "usv.toml", folder)
    vessel = load(str(ORACLE / "usv.toml"))
    rows = ["boat,vessel,recording,mapping,role"]
    for seed, (boat, effects) in enumerate(BOATS.items(), 11):
        produce(folder / boat, vessel, seed, effects, None, 70.0, 4.0, runs=list(RUNS))
        rows += [f"{boat},usv.toml,{boat}/{run}.csv,,{role}" for run, role in RUNS.items()]
    (folder / "torn" / "random-fast.csv").write_bytes(b"t,x\n0,\x00\xff")
    (folder / "fleet.csv").write_text("\n".join([*rows, "ghost,usv.toml,none.csv,,", ""]))
    return folder


def run(harbour, *words):
    return main(["fleet", str(harbour / "fleet.csv"), *map(str, words)])


@pytest.fixture(scope="module")
def audited(harbour, tmp_path_factory):
    """The output folder of a fleet that was audited."""
    out = tmp_path_factory.mktemp("fleet") / "out"
    assert run(harbour, "--until", "audit", "--jobs", 2, "-o", out) == 0
    return out


@pytest.fixture(scope="module")
def fitted(harbour, tmp_path_factory):
    """The output folder of a fleet that was fitted."""
    out = tmp_path_factory.mktemp("fleet") / "out"
    assert run(harbour, "--until", "fit", "--jobs", 2, "-o", out) == 0
    return out


def test_every_recording_is_a_row_and_a_broken_log_says_why(audited):
    rows = pd.read_parquet(audited / "fleet.parquet").to_dict("records")
    failed = {row["boat"]: row for row in rows if row["status"] == "failed"}
    assert len(rows) == 10 and set(failed) == {"torn", "ghost"}
    assert failed["torn"]["recording"].endswith("random-fast.csv") and failed["torn"]["reason"]
    assert "there is no recording" in failed["ghost"]["reason"]
    assert list(failed["torn"]["audit"]) == ["unreadable"]


@pytest.mark.proof
def test_a_boat_is_fitted_beside_its_broken_log(fitted, harbour):
    table = pd.read_parquet(fitted / "fleet.parquet").set_index("boat")
    (alone,) = table.loc["torn"]["N_r"].unique()
    kept = [harbour / "torn" / f"{name}.csv" for name in ("zigzag-fast", "zigzag-slow")]
    same = diffsea.fit(harbour / "usv.toml", kept[0], kept[1])
    (row,) = [row for row in same.study.rows if row["name"] == "N_r"]
    assert alone == pytest.approx(row["value"], rel=1e-4)


@pytest.mark.proof
def test_the_boat_in_the_current_is_the_one_that_changed(fitted):
    table = pd.read_parquet(fitted / "fleet.parquet").groupby("boat")["changed"].first()
    assert table.to_dict()["adrift"] is True and table.to_dict()["sound"] is False
    page = (fitted / "fleet.html").read_text(encoding="utf-8")
    changed = page[page.index('id="changed"') : page.index('id="recurring"')]
    assert "adrift" in changed and "sound" not in changed
    assert "ghost" in page[page.index('id="failures"') : page.index('id="boats"')]


@pytest.mark.proof
def test_a_run_goes_on_with_the_boats_that_are_kept(fitted, harbour, capsys, monkeypatch):
    """Only the boat whose log has changed is done again; where files lie does not count."""
    moved = fitted.parent / "moved"
    shutil.copytree(harbour, moved)
    log = moved / "sound" / "zigzag-slow.csv"
    log.write_text("\n".join(log.read_text().splitlines()[:-5]) + "\n")
    started, start = [], boat_processes._started
    monkeypatch.setattr(
        boat_processes, "_started", lambda *a: started.append(a[2]["boat"]) or start(*a)
    )
    parts = fitted.with_name("out-parts")
    assert len(list(parts.iterdir())) == 3
    words = ("--until", "fit", "-o", fitted.parent / "again", "--parts", parts, "--json")
    assert run(moved, *words) == 0
    told = capsys.readouterr()
    assert started == ["sound", "ghost"] and "2 boats were done before" in told.err
    found = json.loads(told.out)
    again = pd.read_parquet(fitted.parent / "again" / "fleet.parquet")
    first = pd.read_parquet(fitted / "fleet.parquet")
    same = again["boat"] != "sound"
    np.testing.assert_array_equal(again["N_r"][same], first["N_r"][same])
    assert all(str(moved) in path for path in again["recording"])
    assert [one["boat"] for one in found["boats"]] == ["sound", "adrift", "torn", "ghost"]
    assert len(list(parts.iterdir())) == 4


@pytest.mark.proof
def test_a_half_written_part_is_done_again(harbour, tmp_path):
    audited = lambda: diffsea.fleet(harbour / "fleet.csv", until="audit", parts=tmp_path)
    assert audited().reused == 0 and audited().reused == 3
    part = min(tmp_path.iterdir())
    part.write_text(part.read_text()[:100])
    again = audited()
    assert again.reused == 2 and len(again.done) == 3


def test_a_process_that_breaks_down_is_a_row(harbour, monkeypatch):
    """The boat `sound` gets an interpreter that ends at once."""
    start = boat_processes._started

    def broken(folder, number, task, where):
        if task["boat"] == "sound":
            task = {"boat": "sound"}
        return start(folder, number, task, where)

    monkeypatch.setattr(boat_processes, "_started", broken)
    found = diffsea.fleet(harbour / "fleet.csv", until="audit")
    assert [one["boat"] for one in found.done] == ["adrift", "torn"]
    assert "broke down" in found.boats[0]["reason"] and "KeyError" in found.boats[0]["reason"]


@pytest.mark.proof
def test_a_current_that_a_boat_conceals_is_named(harbour):
    rows = [["adrift", "usv.toml", f"adrift/{run}.csv", "", role] for run, role in RUNS.items()]
    table = pd.DataFrame(rows, columns=["boat", "vessel", "recording", "mapping", "role"])
    for column in ("vessel", "recording"):
        table[column] = [str(harbour / name) for name in table[column]]
    found = diffsea.fleet(table)
    assert found.recurring == {"current": ["adrift"]}
    (effect,) = found.boats[0]["effects"]
    assert effect["parameters"]["speed"]["value"] == pytest.approx(0.4, abs=0.05)
    assert "current" in repr(found) and all(found.table["changed"].tolist())


MANIFESTS = {
    "empty": ("", "has no column 'boat'"),
    "two columns": ("boat,vessel,recording,boat\na,kvlcc2,b.csv,c\n", "has two columns 'boat'"),
    "comma in a name": (
        "boat,vessel,recording,role\na,kvlcc2,one, early.csv,train,\n",
        "line 2: more cells than columns",
    ),
    "no recordings": ("boat,vessel,recording\n", "names no recording"),
    "no vessel": ("boat,recording\na,b.csv\n", "no column 'vessel'"),
    "empty cell": ("boat,vessel,recording\na,,b.csv\n", "line 2: vessel is empty"),
    "unknown role": ("boat,vessel,recording,role\na,otter,b.csv,tests\n", "not 'tests'"),
    "two vessels": ("boat,vessel,recording\na,otter,b.csv\na,wamv,c.csv\n", "another vessel"),
    "twice": ("boat,vessel,recording\na,otter,b.csv\na,otter,b.csv\n", "b.csv twice"),
    "nothing to fit": ("boat,vessel,recording,role\na,otter,b.csv,test\n", "of the role train"),
}


@pytest.mark.parametrize("kind", MANIFESTS)
def test_a_manifest_that_cannot_be_used(kind, tmp_path, capsys):
    content, message = MANIFESTS[kind]
    path = tmp_path / "fleet.csv"
    path.write_text(content)
    assert main(["fleet", str(path), "-o", str(tmp_path / "out")]) == 1
    told = capsys.readouterr().err
    assert message in told and "fleet.csv" in told and "bug" not in told
    assert sorted(tmp_path.iterdir()) == [path]


def test_a_fleet_of_which_no_boat_can_be_done_fails(tmp_path, capsys):
    path = tmp_path / "fleet.csv"
    path.write_text("boat,vessel,recording\na,otter,b.csv\n")
    assert main(["fleet", str(path), "--until", "audit", "-o", str(tmp_path / "out")]) == 1
    told = capsys.readouterr().err
    assert "none of the 1 boats could be done" in told and "no recording" in told
    assert sorted(tmp_path.iterdir()) == [path]
