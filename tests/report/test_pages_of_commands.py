"""The page of every command as it writes it, in a browser: whole, quiet, offline, at any width."""

import pytest
from tests.chromium import NAMES, Page, installed, opened
from tests.paths import ROOT

from diffsea.cli import main


pytestmark = [
    pytest.mark.proof,
    pytest.mark.skipif(
        installed() is None, reason=f"no browser is on the path (looked for {', '.join(NAMES)})"
    ),
]

DEMO, MISSIONS = ROOT / "examples" / "demo", ROOT / "examples" / "missions"
USV, RUN, HELD_OUT = DEMO / "usv.toml", DEMO / "recordings" / "circle-fast.csv", DEMO / "held_out"
SURVEY = MISSIONS / "survey_in_a_tide.toml"
ZIGZAG = f"{USV} --manoeuvre zigzag --thrust 200"
SPEEDS = ("1.00", "1.03", "1.06", "1.09")  # m/s, of four zig-zags from which a metamodel is made
COMMANDS = {
    "trial": f"trial {ZIGZAG}",
    "metrics": f"metrics {RUN}",
    "check": f"check {RUN}",
    "audit": f"audit {RUN}",
    "segment": f"segment {RUN}",
    "predict": f"predict {USV} {HELD_OUT / 'zigzag-fast.csv'}",
    "fit": f"fit {USV} {RUN} --free X_u,N_r --profile none",
    "sheet": f"fit {USV} {DEMO / 'sea_trials.toml'} --free X_u,N_r --profile none",
    "online": f"online {USV} {RUN}",
    "mission": f"run {SURVEY}",
    "battery": f"run {SURVEY} --battery {MISSIONS / 'batteries' / 'tides_and_loads.toml'}",
    "grid": f"run {SURVEY} --grid lookahead=3:12:3 heading.gain=0.5:3:3",
    "tune": f"run {SURVEY} --tune lookahead=3:12",
    "campaign": f"campaign {USV} --thrust 200 --trials turning-circle zigzag:10/10",
    "fleet": "fleet fleet.csv --until audit",
    "sensitivity": f"sensitivity {ZIGZAG}",
    "sobol": f"sensitivity {ZIGZAG} --sobol 64 mass=150:220 N_r=-600:-300",
    "sweep": f"sweep {ZIGZAG} --grid mass=150:220:4 N_r=-600:-300:4",
    "metamodel": "metamodel " + " ".join(f"zigzag-{speed}/recording.csv" for speed in SPEEDS),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Where every command has written its page, in a folder of its own name."""
    folder = tmp_path_factory.mktemp("pages")
    rows = "".join(f"{name},{USV},{RUN}\n" for name in ("one", "two"))
    (folder / "fleet.csv").write_text(f"boat,vessel,recording\n{rows}")
    zigzag = "trial kvlcc2 --manoeuvre zigzag --angle 10 --heading 10 --speed"
    trials = {f"zigzag-{speed}": f"{zigzag} {speed}" for speed in SPEEDS}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for name, command in (trials | COMMANDS).items():
            assert main([*command.split(), "-o", name]) == 0, command
    return folder


@pytest.fixture(scope="module")
def page(folder):
    first = next((folder / "trial").glob("*.html"))
    with opened(first, folder / "profile") as shown:
        yield shown


# Of boxes and words in the main part: what reaches beyond the window, unless it can be scrolled.
BEYOND = """
    [...document.querySelectorAll('main *')].filter(e =>
        (e instanceof HTMLElement || e.tagName === 'text')
        && !e.closest('.scroll, pre, .table')
        && (b => b.width > 0 && (b.left < -1 && b.left > -2000
            || b.right > document.documentElement.clientWidth + 1))(e.getBoundingClientRect())
    ).map(e => e.tagName + ' ' + e.textContent.slice(0, 40))
"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize(("width", "phone"), [(1280, False), (400, True)])
@pytest.mark.parametrize("name", COMMANDS)
def test_a_page_is_whole_and_quiet(page: Page, folder, name, width, phone, scheme):
    (file,) = (folder / name).glob("*.html")
    page.complaints.clear()
    page.requests.clear()
    page.resize(width, 900, phone)
    page.prefer(scheme)
    page.show(file)
    assert page.run("document.querySelectorAll('h1').length") == 1
    assert page.run("document.documentElement.lang") == "en"
    root = "document.documentElement"
    assert page.run(f"{root}.scrollWidth - {root}.clientWidth") <= 0
    assert page.run(BEYOND) == []
    page.run("document.querySelectorAll('details').forEach(d => d.open = true)")
    page.until("[...document.querySelectorAll('.plot')].every(p => p.querySelector('svg'))")
    assert page.complaints == []
    assert [one for one in page.requests if not one.startswith(("file:", "data:", "blob:"))] == []
