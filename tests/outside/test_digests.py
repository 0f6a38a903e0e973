"""Digests tell contents apart, and nothing else."""

import hashlib

from diffsea.outside.digests import content_digest


def test_a_file_has_the_digest_of_its_bytes(tmp_path):
    file = tmp_path / "a.csv"
    file.write_bytes(b"t,r\n0,1\n")
    assert content_digest(file) == hashlib.sha256(b"t,r\n0,1\n").hexdigest()


def test_folders_are_told_apart_by_names_and_by_where_their_files_end(tmp_path):
    contents = [
        {"a": b"1", "b": b"2"},
        {"a": b"12", "b": b""},
        {"a": b"1", "c": b"2"},
        {"a": b"12"},
    ]
    found = []
    for number, files in enumerate(contents):
        folder = tmp_path / f"{number}" / "bag"
        folder.mkdir(parents=True)
        for name, content in files.items():
            (folder / name).write_bytes(content)
        found.append(content_digest(folder))
    assert len(set(found)) == len(contents)
    (tmp_path / "0" / "bag").rename(tmp_path / "moved")
    assert content_digest(tmp_path / "moved") == found[0]
