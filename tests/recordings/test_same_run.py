"""One run in every format: the same channels; cut anywhere: what is before the cut, and told so."""

import itertools

import numpy as np
import pytest
from tests.fuzz.seeds import SUFFIXES, seed
from tests.recordings.driven_boat import BOOT

from diffsea import UserError, read_recording
from diffsea.recordings import audit
from diffsea.recordings.readers import to_frame


pytest.importorskip("pymavlink", reason="needs diffsea[ardupilot]")
pytest.importorskip("mcap", reason="needs diffsea[mcap]")
pytest.importorskip("pyulog", reason="needs diffsea[px4]")
pytest.importorskip("rosbags", reason="needs diffsea[ros]")

LOGS = ("bin", "log", "tlog", "tlogcsv", "ulg", "mcap", "ros1", "ros2", "rosmcap")
TABLES = ("csv", "parquet", "mat")
# What the coarsest of them keep: four bytes for a number, hundredths of a degree, by which speeds
# are turned, too, and yaw rates that are sampled more often.
RESOLUTION = {"x": 1e-5, "y": 1e-5, "psi": 1e-4, "u": 2e-4, "v": 2e-4, "r": 1e-3}
ORDERS = 1e-6
SEVEN_DIGITS = (
    1e-4  # m, of positions hundreds of metres away, where a number is written with so many
)


def recordings(folder):
    """The same twelve seconds from a log of every kind, and from tables made of one of them."""
    found = {}
    for kind in LOGS:
        path = folder / f"run-{kind}{SUFFIXES[kind]}"
        path.write_bytes(seed(kind))
        found[kind] = read_recording(path)
    frame = to_frame(found["ros1"])
    frame.to_csv(folder / "run.csv", index=False)
    frame.to_parquet(folder / "run.parquet", index=False)
    from scipy.io import savemat

    savemat(folder / "run.mat", {name: frame[name].to_numpy() for name in frame})
    lines = [f'{name} = ":{name}"' for name in frame]
    (folder / "mat.toml").write_text("[columns]\n" + "\n".join(lines) + "\n")
    found["csv"] = read_recording(folder / "run.csv")
    found["parquet"] = read_recording(folder / "run.parquet")
    found["mat"] = read_recording(folder / "run.mat", folder / "mat.toml")
    return found


def clock(kind, run):
    """Seconds since the log began."""
    return run.t - (0.0 if kind in ("ros1", "ros2", "rosmcap", *TABLES) else BOOT)


def differences(found):
    """The largest difference of every channel, in every pair; orders in shares of full."""
    rows = np.arange(0.5, 11.0, 0.1) + 0.05
    values = {}
    for kind, run in found.items():
        t, own = clock(kind, run), {}
        for name in RESOLUTION:
            known = np.isfinite(getattr(run, name))
            own[name] = np.interp(rows, t[known], getattr(run, name)[known])
        shares = {name: run.commanded[name] for name in ("port", "starboard")}
        if np.max(np.abs(shares["port"])) > 2:  # us
            shares = {name: (series - 1500) / 400 for name, series in shares.items()}
        held = np.searchsorted(t, rows, side="right") - 1
        values[kind] = own | {name: series[held] for name, series in shares.items()}
    return {
        (one, other): {
            name: float(np.max(np.abs(series - values[other][name])))
            for name, series in values[one].items()
        }
        for one, other in itertools.combinations(values, 2)
    }


def test_the_same_run_in_every_format_has_the_same_channels(tmp_path):
    found = recordings(tmp_path)
    assert set(found) == {*LOGS, *TABLES}
    limits = RESOLUTION | {"port": ORDERS, "starboard": ORDERS}
    for pair, apart in differences(found).items():
        for name, size in apart.items():
            limit = 0.0 if set(pair) <= {"ros1", *TABLES} else limits[name]
            if "tlogcsv" in pair and name in ("x", "y"):
                limit = SEVEN_DIGITS
            assert size <= limit, (pair, name, size)


@pytest.mark.parametrize("kind", ["csv", "bin", "log", "tlog", "tlogcsv", "ulg", "mcap"])
@pytest.mark.parametrize("places", [15, pytest.param(1000, marks=pytest.mark.proof)])
def test_of_a_log_that_is_cut_what_is_before_is_read_and_the_audit_says_where(
    tmp_path, kind, places
):
    content = seed(kind)
    path = tmp_path / f"run{SUFFIXES[kind]}"
    path.write_bytes(content)
    whole, read = read_recording(path), 0
    assert not any("ends within" in one.message for one in audit(whole))
    for at in np.unique(np.linspace(10, len(content) - 1, places).astype(int)):
        if kind == "csv" and content[at - 1 :].split(b"\n")[0].count(b",") < 1:
            continue  # within the last cell, or at an end: it cannot be told from a whole file
        path.write_bytes(content[:at])
        try:
            run = read_recording(path)
        except UserError:
            continue
        read += 1
        assert run.t.size <= whole.t.size
        np.testing.assert_array_equal(run.t, whole.t[: run.t.size])
        for name, series in run.motion.items():
            both = np.isfinite(series) & np.isfinite(getattr(whole, name)[: run.t.size])
            expected = getattr(whole, name)[: run.t.size][both]
            np.testing.assert_allclose(series[both], expected, rtol=0, atol=1e-9, err_msg=name)
        cut = [one for one in audit(run) if "ends within" in one.message]
        if run.read.cut_off:
            assert len(cut) == 1 and f"t = {run.t[-1]:g} s" in cut[0].message
            assert cut[0].kind == "gap"
        else:
            assert not cut and _is_at_a_boundary(kind, content, at)
    assert read > places / 4


def _is_at_a_boundary(kind, content, at):
    """Whether a file of so many bytes ends where a message does, as far as it may be told."""
    if kind in ("csv", "log", "tlogcsv"):
        return content[at - 1 : at] in (b"\n", b"\r")
    if kind == "tlog":  # two bytes name a message: a time alone is no part of one
        return True
    if kind == "bin":
        return content[at:].startswith(b"\xa3\x95")
    place = 16  # bytes of the header of a ULog; each message begins with its length and kind
    while kind == "ulg" and place < at:
        place += 3 + int.from_bytes(content[place : place + 2], "little")
    return place == at


@pytest.mark.parametrize("kind", ["parquet", "ros1", "ros2", "rosmcap"])
def test_a_file_with_its_index_at_the_end_is_refused_once_it_is_cut(tmp_path, kind):
    content = seed(kind)
    path = tmp_path / f"run{SUFFIXES[kind]}"
    for at in np.linspace(10, 0.9 * len(content), 12).astype(int):
        path.write_bytes(content[:at])
        with pytest.raises(UserError) as told:
            read_recording(path)
        assert str(path) in str(told.value) and "\n" not in str(told.value)
