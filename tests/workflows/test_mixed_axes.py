"""Files of one layout whose velocities are in different axes, and mappings by the name of a log."""

import json
import pathlib

import numpy as np
import pandas as pd
import pytest

import diffsea
from diffsea.cli import main
from diffsea.workflows.checks import choose_mappings


def table(earth, seed, seconds=120.0, step=0.2):
    """A craft that winds about, in the columns of another program."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, step)
    port, starboard = (5.0 + 4.0 * np.sin(t / period + seed) for period in (6.0, 9.0))
    r = np.zeros(t.size)
    u = np.ones(t.size)
    for k in range(1, t.size):
        r[k] = r[k - 1] + step * (0.06 * (port[k - 1] - starboard[k - 1]) - 0.8 * r[k - 1])
        u[k] = u[k - 1] + step * (0.1 * (port[k - 1] + starboard[k - 1]) - 0.8 * u[k - 1])
    psi = 0.7 * seed + np.concatenate([[0.0], np.cumsum(0.5 * step * (r[1:] + r[:-1]))])
    v = -0.3 * r * u
    velocity = (u + 1j * v) * np.exp(1j * psi)
    place = np.concatenate([[0.0], np.cumsum(0.5 * step * (velocity[1:] + velocity[:-1]))])
    first, second = (velocity.real, velocity.imag) if earth else (u, v)
    noisy = lambda series, by: series + by * rng.standard_normal(t.size)
    return pd.DataFrame(
        {
            "time_s": t,
            "ned_x": noisy(place.real, 0.02),
            "ned_y": noisy(place.imag, 0.02),
            "yaw": noisy(psi, 0.003),
            "vel_x": noisy(first, 0.01),
            "vel_y": noisy(second, 0.01),
            "yaw_rate": noisy(r, 0.004),
            "left_thruster": port,
            "right_thruster": starboard,
        }
    )


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    for name, (earth, seed) in {"a": (True, 1), "b": (True, 2), "c": (False, 3)}.items():
        table(earth, seed).to_csv(folder / f"{name}.csv", index=False)
    return [folder / f"{name}.csv" for name in "abc"]


def test_each_file_is_read_in_its_own_axes(files):
    chosen = choose_mappings(files)
    axes = {path.stem: how.mapping.velocity_axes for path, how in chosen.items()}
    assert axes == {"a": "earth", "b": "earth", "c": "body"}
    assert "velocities north and east" in chosen[files[0]].told
    assert "velocities along the vessel" in chosen[files[2]].told


def test_files_that_agree_have_one_mapping(files):
    chosen = choose_mappings(files[:2])
    assert chosen[files[0]] is chosen[files[1]]
    assert chosen[files[0]].told.startswith("through a mapping proposed")


@pytest.fixture(scope="module")
def checked(files, tmp_path_factory):
    """The folder of a check of all three."""
    out = tmp_path_factory.mktemp("check")
    assert main(["check", *map(str, files), "-o", str(out)]) == 0
    return out


def test_a_check_finds_no_axes_and_names_the_folder_of_the_mappings(files, checked, capsys):
    logs = json.loads((checked / "check.json").read_text())["logs"]
    assert not [one for log in logs.values() for one in log["audit"] if one["kind"] == "axes"]
    page = (checked / "check.html").read_text(encoding="utf-8")
    assert f"c.csv --mapping {checked}" in page.replace("\n", " ")


def test_a_folder_of_mappings_reads_each_log_by_its_own(files, checked, tmp_path, capsys):
    words = ["audit", *map(str, files), "--mapping", str(checked), "-o", str(tmp_path / "audit")]
    assert main(words) == 0
    found = json.loads((tmp_path / "audit" / "audit.json").read_text())
    assert not [one for one in found if one["kind"] == "axes"]
    # Through the mapping of the first alone the third is wrong.
    one = ["--mapping", str(checked / "a.mapping.toml"), "-o", str(tmp_path / "one")]
    assert main(["audit", *map(str, files), *one]) == 0
    found = json.loads((tmp_path / "one" / "audit.json").read_text())
    assert {one["recording"] for one in found if one["kind"] == "axes"} == {"c.csv"}
    speeds = [diffsea.read_recording(path, checked).u for path in files]
    assert all(np.nanmin(u) > -0.2 for u in speeds)
    assert not diffsea.audit(files, checked).headline().count("axes")


def test_an_audit_without_a_mapping_proposes_two(files, tmp_path, capsys):
    out = tmp_path / "audit"
    assert main(["audit", *map(str, files), "-o", str(out)]) == 0
    assert not [one for one in json.loads((out / "audit.json").read_text())
                if one["kind"] == "axes"]  # fmt: skip
    assert sorted(path.name for path in out.glob("*.mapping.toml")) == [
        "a.mapping.toml", "c.mapping.toml",
    ]  # fmt: skip


def test_a_log_without_a_mapping_in_the_folder_is_told(files, checked):
    other = pathlib.Path(files[0]).with_name("d.csv")
    other.write_bytes(files[0].read_bytes())
    with pytest.raises(diffsea.UserError, match=r"no column 't'.*has no d\.mapping\.toml for it"):
        diffsea.read_recording(other, checked)
    with pytest.raises(diffsea.UserError) as missing:
        diffsea.read_recording(other.with_name("nowhere.csv"), checked)
    assert "mapping" not in str(missing.value)
    with pytest.raises(diffsea.UserError, match="a DataFrame has none"):
        diffsea.read_recording(pd.read_csv(other), checked)


def test_a_table_that_needs_no_mapping_is_read_without_one(files, checked, tmp_path):
    native = tmp_path / "native.csv"
    diffsea.write_recording(diffsea.read_recording(files[0], checked), native)
    both = [diffsea.read_recording(path, checked) for path in (native, files[0])]
    np.testing.assert_allclose(both[0].u, both[1].u, atol=1e-9)


def test_two_logs_of_one_name_are_not_read_through_one_mapping(files, checked, tmp_path, capsys):
    twin = tmp_path / "other" / "a.csv"
    twin.parent.mkdir()
    twin.write_bytes(files[2].read_bytes())
    for command in ("audit", "check", "metrics"):
        words = [command, str(files[0]), str(twin), "--mapping", str(checked)]
        assert main([*words, "-o", str(tmp_path / command)]) == 1
        assert "one a.mapping.toml for" in capsys.readouterr().err
    # Nor is the folder named where a check had to number its mappings.
    assert main(["check", *map(str, files), str(twin), "-o", str(tmp_path / "four")]) == 0
    told = [line for line in capsys.readouterr().out.splitlines() if "diagnose boat" in line]
    assert len(told) == 2 and all(line.endswith(".mapping.toml") for line in told)


def test_a_file_that_is_too_short_to_be_asked_alone_goes_with_the_others(files, tmp_path):
    short = tmp_path / "short.csv"
    short.write_text("".join(files[0].read_text().splitlines(keepends=True)[:40]))
    chosen = choose_mappings([*files, short])
    axes = {path.stem: getattr(how, "mapping", None) for path, how in chosen.items()}
    assert axes["a"].velocity_axes == "earth" and axes["c"].velocity_axes == "body"


def test_every_command_that_reads_takes_the_folder(files, checked, tmp_path, capsys):
    through = ["--mapping", str(checked), "-o"]
    assert main(["check", *map(str, files), *through, str(tmp_path / "check")]) == 0
    assert main(["segment", *map(str, files), *through, str(tmp_path / "segment")]) == 0
    record = json.loads((tmp_path / "segment" / "segments.json").read_text())["recordings"]
    used = [one["source"]["mapping"]["file"] for one in record]
    assert used == [f"{path.stem}.mapping.toml" for path in files]
    assert main(["metrics", *map(str, files), *through, str(tmp_path / "metrics")]) == 0
    repaired = ["audit", *map(str, files), "--repair", *through, str(tmp_path / "repaired")]
    assert main(repaired) == 0
    assert len(list((tmp_path / "repaired").glob("*.repaired.csv"))) == 3


def test_a_log_that_the_folder_lacks_stops_no_other(files, checked, tmp_path, capsys):
    other = pathlib.Path(files[0]).with_name("e.csv")
    other.write_bytes(files[0].read_bytes())
    words = [str(files[0]), str(other), "--mapping", str(checked), "-o"]
    assert main(["audit", *words, str(tmp_path / "audit")]) == 0
    assert "has no e.mapping.toml" in (tmp_path / "audit" / "audit.json").read_text()
    # A check proposes one for it.
    assert main(["check", *words, str(tmp_path / "check")]) == 0
    assert (tmp_path / "check" / "e.mapping.toml").exists()
