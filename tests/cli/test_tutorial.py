"""What docs/from-log-to-vessel.md shows is what its commands print today.

    python -m tests.cli.test_tutorial          # writes today's output into the page

The commands of the page are run in their order in an empty folder. A shown line stands for that
line of the output which resembles it most, in order; `...` stands for any number of them.
"""

import contextlib
import difflib
import io
import json
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from tests.paths import ROOT

from diffsea.cli import main


PAGE = ROOT / "docs" / "from-log-to-vessel.md"
TUTORIAL = ROOT / "examples" / "tutorial"
WITHOUT_OUTPUT = ("predict", "diagnose")  # the page shows none of it
FILES = {  # that the page quotes, by how the quoted lines begin
    "    Time [ms];": "mylogs/day1_01.csv",
    "    # Not used:": "out/look/day1_01.mapping.toml",
    '    psi = { column = "Compass", unit = "deg", off': (
        "out/repaired/day1_01.repaired_mapping.toml"
    ),
}
TOLERANCE = 0.03  # of numbers: other processors and versions end in other last digits
_NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?(?![\w])")


def prepare(folder: Path) -> None:
    """Put into the folder what the page has before its first command."""
    for path in TUTORIAL.glob("*.toml"):
        shutil.copy(path, folder)
    subprocess.run([sys.executable, TUTORIAL / "make_logs.py", "mylogs"], cwd=folder, check=True)


def renewed(page: str, folder: Path) -> str:
    """The page with what its commands print when they are run in the folder."""
    told, command, output = [], "", []
    for line in page.splitlines():
        quoted = next((file for start, file in FILES.items() if line.startswith(start)), None)
        if line.strip() and not line.startswith("    "):
            command, output = "", []
        elif command.endswith("\\") or line.startswith("    diffsea "):
            command = command.removesuffix("\\") + line.strip()
            if not command.endswith("\\"):
                output = printed_by(command, folder)
                command = ""
            told.append(line)
            continue
        elif quoted:
            output = (folder / quoted).read_text(encoding="utf-8").splitlines()
        if output and line.strip() not in ("", "..."):
            found, output = next_line(line.strip(), output)
            line = f"    {found}".rstrip()
        told.append(line)
    return "\n".join(told) + "\n"


def printed_by(command: str, folder: Path) -> list[str]:
    """The lines that a command prints; files are given as a shell would expand them."""
    words = shlex.split(command)[1:]
    if words[0] in WITHOUT_OUTPUT:
        return []
    printed = io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(printed):
        expanded = [sorted(map(str, Path().glob(w))) if "*" in w else [w] for w in words]
        assert main([word for some in expanded for word in some]) == 0, command
    return printed.getvalue().splitlines()


def next_line(shown: str, output: list[str]) -> tuple[str, list[str]]:
    """The line of the output that a shown one stands for, and what comes after it."""
    alike = [difflib.SequenceMatcher(None, words(shown), words(one)).ratio() for one in output]
    best = alike.index(max(alike, default=0.0)) if output else -1
    assert output and alike[best] > 0.5, f"nothing like this is printed any more: {shown}"
    return output[best], output[best + 1 :]


def words(line: str) -> list[str]:
    """The words of a line, a sign in place of every number."""
    return _NUMBER.sub("#", line).split()


@pytest.mark.slow
@pytest.mark.proof
def test_the_tutorial_shows_what_its_commands_print(tmp_path):
    prepare(tmp_path)
    page = PAGE.read_text(encoding="utf-8")
    for shown, printed in zip(page.splitlines(), renewed(page, tmp_path).splitlines(), strict=True):
        assert words(shown) == words(printed)
        numbers = ([float(one) for one in _NUMBER.findall(line)] for line in (shown, printed))
        assert next(numbers) == pytest.approx(next(numbers), rel=TOLERANCE), (shown, printed)


def test_what_the_tutorial_says_of_its_tables_is_in_them():
    page = PAGE.read_text(encoding="utf-8")
    (combination,) = re.findall(r"`(-?[\d.]+ N_rr)` says", page)
    assert f"    not determined: {combination} (" in page
    truth = json.loads((ROOT / "examples/demo/truth.json").read_text(encoding="utf-8"))
    (added_mass,) = re.findall(r"^    Y_vdot .* -100 +(-[\d.]+)", page, re.MULTILINE)
    assert "the sway added mass is half of what it should be" in page
    assert float(added_mass) / truth["vessel"]["hull"]["Y_vdot"] == pytest.approx(0.5, abs=0.1)
    assert re.search(r"^    N_rr .* mostly the prior$", page, re.MULTILINE)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as name:
        prepare(Path(name))
        PAGE.write_text(renewed(PAGE.read_text(encoding="utf-8"), Path(name)), encoding="utf-8")
