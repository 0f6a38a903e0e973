"""Several recordings at once: broken ones beside sound ones, and what one tells of another."""

import dataclasses
import json

import numpy as np
import pytest

import diffsea
from diffsea.cli import main
from diffsea.errors import UserError


pytestmark = pytest.mark.slow


def written(path, names="t,x,y,psi,u,v,r", rows=60, seed=0):
    """A straight run with noise."""
    rng = np.random.default_rng(seed)
    t = 0.2 * np.arange(rows)
    true = {"t": t, "x": 1.5 * t, "u": 1.5}
    columns = [np.broadcast_to(true.get(c, 0.0), t.shape) for c in "x,y,psi,u,v,r".split(",")]
    noise = 0.01 * rng.standard_normal((6, rows))
    table = np.stack([t, *(np.stack(columns) + noise)], axis=1)
    np.savetxt(path, table, delimiter=",", header=names, comments="")
    return path


BROKEN = {
    "empty": ("", "is empty"),
    "backwards": ("t,x,psi\n0,1,0\n2,2,0\n1,3,0\n", "time runs backwards"),
    "text": ("t,x,psi\n0,1,0\n1,what,0\n", "is not a number"),
    "without time": ("a,b\n", "no column 't'"),
}


@pytest.mark.parametrize("how", BROKEN)
def test_a_broken_file_is_a_row_and_the_others_are_audited(how, tmp_path, capsys):
    text, told = BROKEN[how]
    sound = [written(tmp_path / f"{n}.csv", seed=n) for n in (1, 2)]
    (tmp_path / "broken.csv").write_text(text)
    files = [str(sound[0]), str(tmp_path / "broken.csv"), str(sound[1])]
    found = diffsea.audit(files)
    assert [one.kind for one in found] == ["unreadable"]
    assert found[0].recording == "broken.csv" and told in found[0].message
    assert found.runs == ("1.csv", "broken.csv", "2.csv")
    assert main(["audit", *files, "--json", "-o", str(tmp_path / "out")]) == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert (row["kind"], row["recording"]) == ("unreadable", "broken.csv")
    assert told in row["message"] and row["value"] is None


def test_a_broken_file_read_through_a_mapping_is_a_row(tmp_path, capsys):
    names = "time,north,east,yaw,u,v,r"
    written(tmp_path / "a.csv", names)
    written(tmp_path / "b.csv", names.replace("yaw", "compass"))
    channels = {"t": "time", "x": "north", "y": "east", "psi": "yaw", "u": "u", "v": "v", "r": "r"}
    lines = ["[columns]", *(f'{channel} = "{column}"' for channel, column in channels.items())]
    (tmp_path / "m.toml").write_text("\n".join(lines))
    words = ["audit", str(tmp_path / "a.csv"), str(tmp_path / "b.csv"), "--json"]
    assert main([*words, "--mapping", str(tmp_path / "m.toml"), "-o", str(tmp_path / "out")]) == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert (row["kind"], row["recording"]) == ("unreadable", "b.csv")
    assert "no column 'yaw'" in row["message"]
    with pytest.raises(UserError, match="none.toml"):
        diffsea.audit([tmp_path / "a.csv"], tmp_path / "none.toml")


def test_nothing_that_can_be_read_is_an_error(tmp_path, capsys):
    (tmp_path / "a.csv").write_text("")
    (tmp_path / "b.csv").write_text("t,x\n0,1\n")
    files = [str(tmp_path / "a.csv"), str(tmp_path / "b.csv")]
    assert main(["audit", *files, "-o", str(tmp_path / "out")]) == 1
    told = capsys.readouterr().err
    assert "none of the 2 recordings can be read" in told
    assert "is empty" in told and "at least two" in told
    assert not (tmp_path / "out").exists()
    with pytest.raises(UserError, match="a.csv is empty"):
        diffsea.audit(files[0])


def test_broken_native_and_foreign_files_together(tmp_path, capsys):
    """Each layout has its mapping; what has none is a row."""
    foreign = "time,north,east,yaw [rad],surge,sway,yaw rate"
    written(tmp_path / "native.csv", rows=100)
    written(tmp_path / "a.csv", foreign, rows=100)
    written(tmp_path / "b.csv", foreign, rows=5)
    written(tmp_path / "c.csv", foreign.replace("yaw [rad]", "heading [rad]"), rows=100)
    (tmp_path / "broken.csv").write_text("")
    names = ["broken", "b", "native", "a", "c"]
    files = [str(tmp_path / f"{name}.csv") for name in names]
    assert main(["audit", *files, "--json", "-o", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr()
    rows = json.loads(printed.out)
    assert {r["recording"] for r in rows if r["kind"] == "unreadable"} == {"broken.csv"}
    assert {p.name for p in (tmp_path / "out").glob("*.toml")} == {
        *("b.mapping.toml", "c.mapping.toml")
    }
    assert printed.err.count("a mapping was proposed") == 2


def zigzag(seed, amplitude, earth, heading=0.0, rows=600, noise=0.02):
    """A run that weaves about one heading (rad) by an amplitude; sway lags the heading."""
    rng = np.random.default_rng(seed)
    t = 0.2 * np.arange(rows)
    rate = 2 * np.pi / 25
    psi = heading + amplitude * np.sin(rate * t)
    v = -0.25 * amplitude * 1.5 * np.cos(rate * t)
    flow = (1.5 + 1j * v) * np.exp(1j * psi)
    path = 0.2 * np.concatenate([[0], np.cumsum(0.5 * (flow[1:] + flow[:-1]))])
    uv = flow if earth else 1.5 + 1j * v
    true = {"x": path.real, "y": path.imag, "psi": psi, "u": uv.real, "v": uv.imag}
    true["r"] = amplitude * rate * np.cos(rate * t)
    spread = {"x": 3 * noise, "y": 3 * noise, "psi": 0.2 * noise, "r": 0.2 * noise}
    channels = {n: s + spread.get(n, noise) * rng.standard_normal(rows) for n, s in true.items()}
    return diffsea.Trajectory(
        t=t, **channels, commanded={}, executed={}, extra={}, valid=np.ones(rows, bool),
        name=f"{seed}.csv",
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("degrees", [5.0, 8.0, 15.0])
def test_earth_axes_show_on_a_nearly_straight_track(degrees, seed):
    """At 5 deg of weaving the ship's axes leave 0.4 % of the squared displacement."""
    amplitude = np.radians(degrees)
    (finding,) = diffsea.audit(zigzag(seed, amplitude, earth=True))
    assert (finding.kind, finding.channels) == ("axes", ("u", "v"))
    assert finding.value < 0.1 and not finding.doubt
    assert not diffsea.audit(zigzag(seed, amplitude, earth=False))
    assert not diffsea.audit(zigzag(seed, amplitude, earth=False, heading=1.0))


def test_a_run_that_cannot_tell_takes_what_the_others_tell():
    straight = zigzag(9, 0.0, earth=True)
    assert not diffsea.audit(straight)
    others = [zigzag(seed, 0.1, earth=True) for seed in range(3)]
    found = {finding.recording: finding for finding in diffsea.audit([*others, straight])}
    assert {(f.kind, f.channels) for f in found.values()} == {("axes", ("u", "v"))}
    assert len(found) == 4
    assert "this run alone does not tell clearly, but 3 recorded alike do" in found["9.csv"].message
    assert "this run alone" not in found["0.csv"].message


def test_runs_of_two_conventions_are_judged_apart():
    """And one that cannot tell has nobody to follow where the others disagree."""
    earth = [zigzag(seed, 0.1, earth=True) for seed in range(2)]
    ship = [zigzag(seed, 0.1, earth=False) for seed in range(10, 14)]
    found = diffsea.audit([*earth, *ship, zigzag(20, 0.0, earth=True)])
    assert sorted(finding.recording for finding in found) == ["0.csv", "1.csv"]


@pytest.mark.proof
def test_noise_accuses_no_axes():
    """60 runs with slow errors of heading or position, straight and weaving, by themselves."""
    alarms = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        run = zigzag(seed, 0.1 * rng.random() * (seed % 3), False, rng.uniform(-3, 3))
        slow = np.cumsum(rng.standard_normal((3, run.t.size)), axis=1) * [[2e-3], [0.03], [0.03]]
        parts = zip(("psi", "x", "y"), slow, strict=True)
        channels = {name: getattr(run, name) + error for name, error in parts}
        found = diffsea.audit(dataclasses.replace(run, **channels))
        alarms += [f for f in found if f.channels == ("u", "v") and f.kind == "axes"]
    assert len(alarms) == 0
