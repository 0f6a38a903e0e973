"""What meets files of others: documents, names, sizes, and writing for good."""

import json
import os
import pathlib
import re

import pytest

from diffsea.cli import main
from diffsea.cli.outputs import Outputs, json_text
from diffsea.errors import UserError
from diffsea.outside.documents import LARGEST, read_json, read_toml
from diffsea.outside.durable import written_beside
from diffsea.outside.printable import printable
from diffsea.outside.sizes import Meter, check_size, size_limit


ROOT = pathlib.Path(__file__).parents[2]
BAD = {
    "brackets": ("a = " + "[" * 5000, "nested deeper"),
    "dotted": ("a." * 5000 + "b = 1", "nested deeper"),
    "digits": ("a = " + "1" * 5000, "thousands of digits"),
    "beyond 64 bits": ("[t]\na = " + "1" * 30, "t.a is an integer beyond 64 bits"),
    "date": ("[t]\na = [1979-05-27]", r"t\.a\[0\] = 1979-05-27 is a date"),
    "denormal": ("a = 5e-324", "a = 4.94066e-324 is too large or too small"),
    "huge": ("a = -1e300", "a = -1e\\+300 is too large"),
    "too large": ("#" * (LARGEST + 1), "larger than 4 MB"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_hostile_document_is_one_line_with_file_and_key(name, tmp_path):
    content, told = BAD[name]
    path = tmp_path / "bad.toml"
    path.write_text(content)
    with pytest.raises(UserError, match=told) as error:
        read_toml(path, "the mapping")
    assert "\n" not in str(error.value) and "bad.toml" in str(error.value)
    assert len(str(error.value)) < 400


def test_a_hostile_result_is_refused(tmp_path):
    path = tmp_path / "fit.json"
    for content in ("[" * 100_000, '{"a": ' + "1" * 5000 + "}", "{"):
        path.write_text(content)
        with pytest.raises(UserError, match="nested deeper|is not JSON"):
            read_json(path, "the fit")


def test_every_toml_file_from_outside_goes_through_the_one_loader():
    sources = {path: path.read_text() for path in (ROOT / "src").rglob("*.py")}
    direct = {path.name for path, text in sources.items() if "tomllib.loads(" in text}
    # Besides the loader: catalogues that ship with the package, and texts that it made itself.
    assert direct == {
        "documents.py", "finding.py", "names.py", "recognition.py", "new.py", "proposal.py"
    }  # fmt: skip


def test_nothing_that_is_read_is_unpickled_or_evaluated():
    """But for what a cluster's scheduler and workers send."""
    risky = re.compile(
        r"\b(?:cloud)?pickle\b|\bmarshal\b|\bshelve\b|allow_pickle=True|np\.load\((?!.*allow_pickle=False)|joblib|dill|"
        r"(?<![\w.])(?:eval|exec)\(|yaml\.load\(|read_pickle|read_hdf"
    )
    for path in set((ROOT / "src").rglob("*.py")) - {ROOT / "src/diffsea/outside/cluster.py"}:
        for line in path.read_text().splitlines():
            assert not risky.search(line), f"{path.name}: {line}"


def test_names_act_on_no_terminal():
    shown = printable("a\x1b]0;x\x07\x9b31m\u202eb\ud800\r\nnext\tcell " + "y" * 5000)
    assert shown.splitlines()[0] == "a\\x1b]0;x\\x07\\x9b31m\\u202eb\\ud800\\x0d"
    assert "next\tcell" in shown and "more letters)" in shown and len(shown) < 4200
    assert printable("Ærøskøbing → 12°") == "Ærøskøbing → 12°"


def test_json_keeps_names_and_prints_none_that_act():
    name = "a\x9b\u202e\U000e0041é"
    text = json_text({name: 1})
    assert json.loads(text) == {name: 1} and "é" in text
    assert not set("\x9b\u202e\U000e0041") & set(text)


def test_file_names_that_are_not_utf_8_or_too_long_are_told(tmp_path, capsys):
    path = os.path.join(os.fsencode(tmp_path), b"\xff\x1b[2J.csv")
    pathlib.Path(os.fsdecode(path)).write_text("t,psi\n0,0\n1,0\n2,0\n3,0\n4,0\n")
    out = tmp_path / "out"
    assert main(["metrics", os.fsdecode(path), "-o", str(out)]) == 0
    assert "\x1b" not in capsys.readouterr().out
    assert main(["metrics", "a" * 300 + ".csv", "-o", str(tmp_path / "no")]) == 1
    assert "File name too long" in capsys.readouterr().err and not (tmp_path / "no").exists()
    with pytest.raises(UserError, match="too long"), Outputs(tmp_path / "new") as files:
        files.text("fine.txt", "")
        files.text("a" * 256, "")
    assert not (tmp_path / "new").exists()


def test_sizes_above_the_limit_are_refused_and_the_limit_can_be_changed(tmp_path):
    with size_limit(1000):
        check_size(tmp_path, 1000)
        with pytest.raises(UserError, match="--max-size"):
            check_size(tmp_path, 1001)
        meter = Meter(tmp_path)
        meter.add(600)
        with pytest.raises(UserError, match="more than 0.001 MB"):
            meter.add(600)
    check_size(tmp_path, 1001)


def test_a_file_is_flushed_before_it_takes_its_place_and_its_folder_after(tmp_path, monkeypatch):
    done, fsync, replace = [], os.fsync, os.replace

    def flushed(handle):
        done.append(("fsync", os.fstat(handle).st_ino))
        fsync(handle)

    def replaced(source, target):
        done.append(("replace", os.stat(source).st_ino))
        replace(source, target)

    monkeypatch.setattr(os, "fsync", flushed)
    monkeypatch.setattr(os, "replace", replaced)
    target = tmp_path / "a.txt"
    with written_beside(target) as beside:
        beside.write_text("new")
    file, folder = target.stat().st_ino, tmp_path.stat().st_ino
    expected = [("fsync", file), ("replace", file), ("fsync", folder)]
    assert done == expected and target.read_text() == "new"
    done.clear()
    with Outputs(tmp_path / "out") as out:
        out.text("b.txt", "b")
    made = tmp_path / "out" / "b.txt"
    assert done == [
        ("fsync", made.stat().st_ino),
        ("replace", made.stat().st_ino),
        ("fsync", made.parent.stat().st_ino),
    ]


def test_what_fails_leaves_the_old_file_and_no_part(tmp_path):
    target = tmp_path / "a.txt"
    target.write_text("old")
    with pytest.raises(ZeroDivisionError), written_beside(target) as beside:
        beside.write_text("half")
        _ = 1 / 0
    assert target.read_text() == "old" and os.listdir(tmp_path) == ["a.txt"]


def test_a_folder_in_the_way_of_one_result_keeps_all_from_being_written(tmp_path):
    (tmp_path / "b.txt").mkdir()
    with pytest.raises(UserError, match="b.txt is a folder"), Outputs(tmp_path) as out:
        out.text("a.txt", "")
        out.text("b.txt", "")
    assert os.listdir(tmp_path) == ["b.txt"]
