"""What the true structure would gain on held-out runs, beside what the diagnosis gains.

    python -m experiments.concealed.gains --set develop [--most 20]

For decided cases with an effect of at least eight detection limits: the tool's own fit of the
vessel with the *true* effects' names, against its fit without effects and its diagnosed vessel,
each by `diffsea predict` on the held-out runs (root-mean-square position error 20 s ahead). The
names are the truth, so this runs after the diagnoses and apart from them. Writes DIR/gains.json.
"""

import argparse
import contextlib
import io
import json
import math
import tempfile
from pathlib import Path

from .outcomes import read_all
from .score import LARGE


HORIZON = "20"


def held_out_error(main, vessel: Path, runs: list[Path], out: Path) -> float:
    """Root-mean-square position error over the runs, m."""
    total, starts = 0.0, 0
    for run in runs:
        _quiet(main, ["predict", str(vessel), str(run), "-o", str(out)])
        text = (out / "predict.json").read_text(encoding="utf-8")
        found = json.loads(text)["horizons"][HORIZON]
        total += found["starts"] * found["position"] ** 2
        starts += found["starts"]
    return math.sqrt(total / starts)


def _quiet(main, arguments: list[str]) -> None:
    said = io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        status = main(arguments)
    if status:
        raise RuntimeError(said.getvalue()[-400:])


def gain(main, folder: Path, case: str, names: list[str]) -> dict:
    """{"case", "nominal", "true", "diagnosed"}: errors in m."""
    here = folder / "cases" / case
    train, test = (sorted((here / d).glob("*.csv")) for d in ("train", "test"))
    row: dict = {"case": case}
    with tempfile.TemporaryDirectory() as work:
        for kind, extra in (("nominal", []), ("true", ["--effects", ",".join(names)])):
            out = Path(work) / kind
            vessel = str(here / "vessel.toml")
            _quiet(main, ["fit", vessel, *map(str, train), *extra, "-o", str(out)])
            row[kind] = held_out_error(main, out / "vessel.toml", test, Path(work) / "p")
        diagnosed = folder / "results" / case / "vessel.toml"
        row["diagnosed"] = held_out_error(main, diagnosed, test, Path(work) / "p")
    return row


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--set", default="develop")
    parser.add_argument("--out", type=Path, help="folder of the set (default: out/concealed/SET)")
    parser.add_argument("--most", type=int, default=20, help="cases at most (default 20)")
    args = parser.parse_args()
    folder = args.out or Path("out/concealed") / args.set
    from diffsea.cli import main as tool

    rows: list[dict] = []
    large = [o for o in read_all(folder) if o.decided and o.limits and min(o.limits) >= LARGE]
    for o in large[: args.most]:
        try:
            rows.append(gain(tool, folder, o.case, o.true))
        except (RuntimeError, KeyError, OSError) as failure:
            print(f"{o.case}: {failure}")
            continue
        print(rows[-1], flush=True)
    (folder / "gains.json").write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
