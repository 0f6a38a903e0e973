"""Sweeps part by part: designs by number, shards, going on, and the merged table."""

import json

import numpy as np
import pandas as pd
import pytest
from tests.boats import BOAT

from diffsea import UserError
from diffsea.cli import main
from diffsea.simulation.designs import AT_ONCE, Grid, LatinHypercube
from diffsea.studies import merging
from diffsea.studies.parts import read_parts
from diffsea.studies.sweep import Sweeper


pytestmark = pytest.mark.compiles


ORDERED = ["--manoeuvre", "zigzag", "--executes", "2", "--step", "0.1"]
GRID = ["--grid", "mass=-190:230:3", "N_r=-300:60000:2", "I_z=300:3000:2", "--part", "4"]


def test_designs_follow_from_their_numbers():
    grid = Grid({"a": (0.0, 1.0, 3), "b": (2.0, 4.0, 5)})
    sample = LatinHypercube({"a": (0.0, 1.0), "b": (2.0, 4.0)}, 1000, 3)
    for space in (grid, sample):
        whole = space.all().values
        parts = [space.rows(k, min(k + 7, space.count)).values for k in range(0, space.count, 7)]
        np.testing.assert_array_equal(np.concatenate(parts), whole)
    assert [tuple(row) for row in grid.rows(4, 6).values] == [(0.0, 4.0), (0.5, 2.0)]


def test_a_sample_of_a_billion_is_not_held():
    space = LatinHypercube({"mass": (100.0, 200.0), "x_G": (-1.0, 1.0)}, 1_000_000_007, 5)
    values = space.rows(999_999_000, 1_000_000_007).values
    assert len(values) == 1007 and len(np.unique(values[:, 0])) == 1007
    assert 100 <= values[:, 0].min() and values[:, 0].max() <= 200
    assert values.mean(0) == pytest.approx([150.0, 0.0], abs=10.0)
    assert abs(np.corrcoef(values.T)[0, 1]) < 0.15
    with pytest.raises(UserError, match=f"at most {AT_ONCE}"):
        space.all()


def test_neighbouring_designs_of_a_sample_are_independent():
    values = LatinHypercube({"a": (0.0, 1.0)}, 20_000, 1).all().values[:, 0]
    assert abs(np.corrcoef(values[1:], values[:-1])[0, 1]) < 4 / np.sqrt(len(values))


@pytest.mark.parametrize("collected", [10, 1_000_000])
def test_the_median_of_a_stream_is_that_of_the_whole(collected, monkeypatch):
    monkeypatch.setattr(merging, "COLLECTED", collected)
    monkeypatch.setattr(merging, "BINS", 7)
    rng = np.random.default_rng(0)
    for values in (
        rng.lognormal(size=1001),
        rng.lognormal(size=1000),
        np.repeat([1.0, 2.0, 2.0, 3.0], 500),
        np.append(np.zeros(600), rng.normal(size=601)),
        np.array([5.0]),
    ):
        found = merging.extent(lambda values=values: iter(np.array_split(values, 9)))
        assert found["median"] == np.median(values)
        assert (found["least"], found["most"]) == (values.min(), values.max())


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A boat, and its sweep in one go."""
    folder = tmp_path_factory.mktemp("sweep")
    (folder / "boat.toml").write_text(BOAT)
    assert main(words(folder, folder / "whole")) == 0
    return folder


def words(folder, out, *more):
    return ["sweep", str(folder / "boat.toml"), *ORDERED, *GRID, "-o", str(out), *more]


def results(folder):
    return {one.name: one.read_bytes() for one in folder.iterdir()}


@pytest.mark.slow
@pytest.mark.usefixtures("own_cache")
def test_shards_merge_to_the_results_of_one_process(whole, tmp_path, capsys):
    kept = ["--parts", str(tmp_path / "parts")]
    for shard in ("2/2", "1/2"):
        assert not (tmp_path / "out").exists()
        assert main(["sweep", "merge", str(tmp_path / "parts"), "-o", str(tmp_path / "out")]) == 1
        told = capsys.readouterr().err
        assert ("no parts" if shard == "2/2" else "2 of 3 parts are missing") in told
        assert main(words(whole, tmp_path / "unused", *kept, "--shard", shard)) == 0
        assert "diffsea sweep merge" in capsys.readouterr().out
    assert not (tmp_path / "unused").exists()
    assert main(["sweep", "merge", str(tmp_path / "parts"), "-o", str(tmp_path / "out")]) == 0
    assert results(tmp_path / "out") == results(whole / "whole")
    (manifest,) = (tmp_path / "parts").glob("*/manifest.json")
    content = json.loads(manifest.read_text())
    assert (content["parts"], content["part"], content["designs"]) == (3, 4, 12)


@pytest.mark.slow
@pytest.mark.usefixtures("own_cache")
def test_parts_that_are_done_are_not_done_again_and_a_broken_one_is(
    whole, tmp_path, monkeypatch, capsys
):
    kept, run, done = whole / "whole-parts", Sweeper.run, []

    def counted(sweeper, designs, *args, **options):
        done.append(len(designs.values))
        return run(sweeper, designs, *args, **options)

    monkeypatch.setattr(Sweeper, "run", counted)
    again = words(whole, tmp_path / "out", "--parts", str(kept), "--resume")
    (part,) = kept.glob("*/part-00000001.parquet")
    part.write_bytes(part.read_bytes()[:-9])
    assert main(again) == 0 and done == [4]
    assert "2 of 3 parts were done before" in capsys.readouterr().err
    assert results(tmp_path / "out") == results(whole / "whole")
    (part.parent / ".unfinished-by-a-killed-process").mkdir()
    assert main(again) == 0 and done == [4]
    assert not list(part.parent.glob(".*"))
    other = [word.replace("60000", "50000") for word in again]
    assert main(other) == 1 and "leave --resume out" in capsys.readouterr().err


@pytest.mark.slow
def test_parts_of_a_sweep_have_columns_of_their_own_and_the_table_has_all(whole):
    """In the first part every design is impossible, so that it has no verdict."""
    parts = [pd.read_parquet(one) for one in sorted((whole / "whole-parts").glob("*/part-*"))]
    table = pd.read_parquet(whole / "whole" / "sweep.parquet")
    assert [set(part["outcome"]) == {"impossible"} for part in parts] == [True, False, False]
    assert "imo_overshoot_1" not in parts[0] and "imo_overshoot_1" in table
    assert len(table) == 12 and not table.isna().all().any()
    assert list(table)[-1] == "outcome" and list(table)[:3] == ["mass", "N_r", "I_z"]


@pytest.mark.slow
def test_the_designs_of_the_least_and_the_most_are_named(whole):
    table = pd.read_parquet(whole / "whole" / "sweep.parquet")
    summary = json.loads((whole / "whole" / "sweep.json").read_text())
    for name, column in summary["metrics"].items():
        for end in ("least", "most"):
            design = pd.Series(column[f"{end}_design"])
            assert list(design.index) == ["mass", "N_r", "I_z"]
            [value] = table.loc[(table[list(design.index)] == design).all(axis=1), name]
            assert value == column[end]


def test_ends_are_found_beyond_the_first_batch_of_rows(tmp_path):
    mass = np.arange(140_000.0)
    period = np.where(mass == 70_001, -1.0, np.where(mass == 139_999, 9.0, 1.0 + mass % 2))
    rows = pd.DataFrame({"mass": mass, "period": period, "outcome": "completed"})
    rows.to_parquet(tmp_path / "sweep.parquet")
    found = merging.summarise(tmp_path / "sweep.parquet", ["mass"])["metrics"]["period"]
    assert found["least_design"] == {"mass": 70_001.0}
    assert found["most_design"] == {"mass": 139_999.0}


def test_a_number_that_no_design_has_names_none(tmp_path):
    table = tmp_path / "sweep.parquet"
    rows = {"mass": [60.0, 80.0], "period": [np.nan, np.nan], "outcome": ["impossible"] * 2}
    pd.DataFrame(rows).to_parquet(table)
    found = merging.summarise(table, ["mass"])["metrics"]["period"]
    assert found["least_design"] is None and found["most_design"] is None


@pytest.mark.parametrize("shard", ["0/2", "3/2", "1", "a/b"])
def test_a_shard_that_cannot_be_is_bad_usage(shard, tmp_path, capsys):
    assert main(["sweep", "otter", *ORDERED, *GRID, "--shard", shard, "-o", str(tmp_path)]) == 2
    assert "--shard" in capsys.readouterr().err
    assert main(["sweep", "merge"]) == 2 and main(["sweep", "otter"]) == 2


@pytest.mark.parametrize(("units", "told"), [({"mass": "kg"}, "kg"), (None, ""), (["kg"], "")])
def test_a_manifest_without_units_or_with_others_tells_none(tmp_path, units, told):
    manifest = {"designs": 1, "part": 1, "parts": 1} | ({} if units is None else {"units": units})
    (tmp_path / "manifest.json").write_text(json.dumps(manifest))
    assert read_parts(tmp_path).unit_of("mass") == told
