"""The package as a user gets it: a wheel, installed into an empty environment."""

import subprocess
import sys
import zipfile

import pytest
from tests.paths import ROOT


def run(*command, **options) -> str:
    done = subprocess.run(
        [str(word) for word in command], capture_output=True, text=True, **options
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    run(sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "-w", folder, ROOT)
    (path,) = folder.glob("diffsea-*.whl")
    return path


@pytest.mark.slow
def test_the_wheel_has_vessels_templates_and_types(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    for wanted in (
        "diffsea/py.typed",
        "diffsea/__init__.pyi",
        "diffsea/vessel/data/otter.toml",
    ):
        assert wanted in names
    templates = sorted(p.name for p in (ROOT / "src/diffsea/report/templates").glob("*.j2"))
    assert templates
    assert {f"diffsea/report/templates/{name}" for name in templates} <= set(names)
    assert any(name.endswith("licenses/LICENSE") for name in names)


@pytest.mark.proof
@pytest.mark.slow
def test_the_wheel_runs_a_trial_in_an_empty_environment(wheel, tmp_path):
    run(sys.executable, "-m", "venv", tmp_path / "venv")
    scripts = tmp_path / "venv" / ("Scripts" if sys.platform == "win32" else "bin")
    run(scripts / "python", "-m", "pip", "install", "--quiet", "--no-compile", wheel)
    out = tmp_path / "out"
    options = ("--manoeuvre", "turning-circle", "-o", out)
    printed = run(scripts / "diffsea", "trial", "otter", *options, cwd=tmp_path)
    assert "tactical_diameter" in printed
    assert (out / "metrics.json").exists() and (out / "track.png").exists()
