"""The gallery: pictures and pages that commands of the library write while the site is built."""

import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

from kept import KEPT, ROOT, state_of
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files


class Shown(NamedTuple):
    """A command, and which of its files are shown."""

    title: str
    command: str
    files: tuple[str, ...]
    told: str


GALLERY = (
    Shown(
        "A turning circle",
        "trial kvlcc2 --manoeuvre turning-circle --angle 35",
        ("track.png",),
        "Numbers and verdicts of IMO MSC.137(76) are in `metrics.json` beside the picture. "
        "[Virtual sea trials](virtual-sea-trials.md).",
    ),
    Shown(
        "A zig-zag of a boat with two thrusters",
        "trial otter --manoeuvre zigzag --angle 20 --heading 20",
        ("series.png",),
        "The angle is rudder-equivalent: a difference of thrusts. Orders are reversed at the "
        "instant at which the heading reaches its value, inside the time step.",
    ),
    Shown(
        "What the overshoots depend on",
        "sensitivity otter --manoeuvre zigzag",
        ("tornado.png",),
        "Derivatives through the switching. "
        "[Sweeps and sensitivities](sweeps-and-sensitivities.md).",
    ),
    Shown(
        "A map of designs",
        "sweep otter --manoeuvre turning-circle --grid mass=60:120:12 thrust=60:200:12",
        ("map.png",),
        "One trial of each design, batched. "
        "[Sweeps and sensitivities](sweeps-and-sensitivities.md).",
    ),
    Shown(
        "Trials in a recording",
        "segment examples/demo/recordings/zigzag-slow.csv --vessel examples/demo/usv.toml",
        ("zigzag-slow.png",),
        "Found by their orders and traced to the motion. [Segments](segments.md).",
    ),
    Shown(
        "A recording predicted from its orders",
        "predict examples/demo/usv.toml examples/demo/held_out/zigzag-fast.csv",
        ("prediction.png",),
        "The vessel file of the demo as it is, before any fit: it starts in the first measured "
        "state and is corrected by nothing.",
    ),
    Shown(
        "What is in a log",
        "check examples/demo/recordings/zigzag-slow.csv",
        ("check.html",),
        "Without a mapping or a vessel: what was recorded, whether it is sound, what it shows, and "
        "what it cannot tell. [From a log to a vessel](from-log-to-vessel.md).",
    ),
    Shown(
        "A diagnosis",
        "diagnose examples/demo/usv.toml examples/demo/recordings/circle-fast.csv "
        "examples/demo/recordings/random-fast.csv examples/demo/recordings/speed-steps.csv "
        "examples/demo/recordings/zigzag-slow.csv --test examples/demo/held_out/random-slow.csv "
        "examples/demo/held_out/zigzag-fast.csv",
        ("report.html",),
        "Recorded tracks beside free predictions before and after, and what was left out of the "
        "model. [Diagnosis](diagnosis.md).",
    ),
    Shown(
        "A campaign of trials",
        "campaign kvlcc2",
        ("campaign.html",),
        "Circles and zig-zags to both sides, with the verdicts of IMO. "
        "[Virtual sea trials](virtual-sea-trials.md).",
    ),
    Shown(
        "Estimates as the boat ran",
        "online examples/demo/usv.toml examples/demo/recordings/random-fast.csv --free X_u,N_r",
        ("online.html",),
        "Parameters, their trust and what a gate would have passed. [Online](online.md).",
    ),
    Shown(
        "A mission in a tide",
        "run examples/missions/survey_in_a_tide.toml",
        ("run.html",),
        "Waypoints in closed loop, with weather and sensors. [Missions](missions.md).",
    ),
)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Make what is shown, where its sources have changed, and add the page."""
    state = state_of([Path(__file__)])
    with ThreadPoolExecutor(2) as workers:
        folders = list(workers.map(lambda shown: _made(shown, state), GALLERY))
    parts = [
        "# Gallery",
        "Every picture here was written by the command above it when the site was built. More are "
        "on the pages of the notebooks and of the experiments.",
    ]
    for shown, folder in zip(GALLERY, folders, strict=True):
        parts += [f"## {shown.title}", f"    diffsea {shown.command}", shown.told]
        for name in shown.files:
            uri = f"gallery/{folder.name}/{name}"
            files.append(File.generated(config, uri, abs_src_path=str(folder / name)))
            link = f"[{shown.title}]({uri})"
            parts.append(
                f"!{link}" if name.endswith(".png") else f"The page that it writes: {link}"
            )
    files.append(File.generated(config, "gallery.md", content="\n\n".join(parts) + "\n"))
    return files


def _made(shown: Shown, state: str) -> Path:
    folder = KEPT / "gallery" / shown.title.lower().replace(" ", "-")
    mark = folder / "state.txt"
    if mark.exists() and mark.read_text(encoding="utf-8") == state:
        return folder
    shutil.rmtree(folder, ignore_errors=True)
    command = [sys.executable, "-m", "diffsea", *shown.command.split(), "-o", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    missing = [name for name in shown.files if not (folder / name).exists()]
    if done.returncode or missing:
        said = done.stderr.strip() or f"it wrote no {', '.join(missing)}"
        raise PluginError(f"gallery: `diffsea {shown.command}` failed: {said}")
    mark.write_text(state, encoding="utf-8")
    return folder
