"""Simpler methods on the same cases and the same candidate terms.

    python -m experiments.concealed.baselines --set develop

- score test without refit: the first of the tool's own screening, before any refit
- forward likelihood-ratio selection on the inverse-dynamics residual, stopped by BIC
- pysindy STLSQ on the same residual; the same in weak form (test functions over windows)
- ridge refit of everything, what is more than four standard errors from zero

Each names up to three effects, the strongest first. Writes DIR/baselines.json, which score.py
puts beside the tool's figures.
"""

import argparse
import json
import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .terms import WINDOW, Regression, regression


MOST = 3  # names
Namer = Callable[[Regression], list[str]]


@dataclass
class Projected:
    """The problem less what the nuisances mimic, on the triangular factor of the candidates.

    Least squares on it are those of all rows: `rest` is what no candidate reaches.
    """

    y: np.ndarray  # (k,)
    terms: dict[str, np.ndarray]  # name: (k, columns), unit length
    rest: float
    rows: int

    def left(self, names: list[str]) -> float:
        """Sum of squares left by these names."""
        y = self.y
        if names:
            A = np.hstack([self.terms[n] for n in names])
            y = y - A @ np.linalg.lstsq(A, y, rcond=1e-8)[0]
        return self.rest + float(y @ y)

    def owners(self) -> list[str]:
        """The name of each column."""
        return [k for k, c in self.terms.items() for _ in range(c.shape[1])]


def project(problem: Regression) -> Projected:
    """Take the nuisances out and scale columns to unit length."""
    Q, _ = np.linalg.qr(problem.base / np.maximum(np.linalg.norm(problem.base, axis=0), 1e-12))
    found = {}
    for name, columns in problem.candidates.items():
        left = columns - Q @ (Q.T @ columns)
        size = np.linalg.norm(left, axis=0)
        # What the nuisances mimic entirely cannot be a candidate.
        seen = size > 1e-6 * np.maximum(np.linalg.norm(columns, axis=0), 1e-12)
        if seen.any():
            found[name] = left[:, seen] / size[seen]
    y = problem.y - Q @ (Q.T @ problem.y)
    P, R = np.linalg.qr(np.hstack(list(found.values())))
    edges = np.cumsum([0, *(c.shape[1] for c in found.values())])
    parts = zip(found, edges[:-1], edges[1:], strict=True)
    small = P.T @ y
    rest = float(y @ y) - float(small @ small)
    return Projected(small, {k: R[:, a:b] for k, a, b in parts}, max(rest, 0.0), len(y))


def forward(problem: Regression) -> list[str]:
    """Add the term that lowers the log of the residual most, while BIC falls."""
    p = project(problem)
    n = p.rows / WINDOW  # neighbouring samples are smoothed together
    chosen: list[str] = []
    while len(chosen) < MOST:
        before = p.left(chosen)

        def gain(name: str, before: float = before) -> float:
            drop = n * math.log(before / max(p.left([*chosen, name]), 1e-300))
            return drop - p.terms[name].shape[1] * math.log(n)

        name = max((k for k in p.terms if k not in chosen), key=gain)
        if gain(name) <= 0.0:
            break
        chosen.append(name)
    return chosen


def stlsq(problem: Regression) -> list[str]:
    """pysindy's sequentially thresholded least squares; threshold by BIC over a grid."""
    p = project(problem)
    return _sparse(p, p.rows / WINDOW)


def weak(problem: Regression) -> list[str]:
    """The same on integrals against bumps (1 - s^2)^2 over windows, half overlapping."""
    width = 31
    s = np.linspace(-1.0, 1.0, width)
    bump = (1.0 - s**2) ** 2
    edges = np.cumsum([0, *problem.rows])
    starts = [k for a, b in zip(edges[:-1], edges[1:], strict=True)
              for k in range(a, b - width, width // 2)]  # fmt: skip
    pick = lambda z: np.array([bump @ z[k : k + width] for k in starts])
    terms = {k: pick(c) for k, c in problem.candidates.items()}
    p = project(Regression(pick(problem.y), pick(problem.base), terms, []))
    return _sparse(p, p.rows / 2.0)


def _sparse(p: Projected, n: float) -> list[str]:
    import pysindy

    A, owner = np.hstack(list(p.terms.values())), p.owners()
    whole = p.left([])
    best, found = n * math.log(whole), np.zeros(len(owner))
    for threshold in np.geomspace(0.02, 0.6, 12) * math.sqrt(whole):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that everything was thresholded away
            optimizer = pysindy.STLSQ(threshold=threshold, alpha=0.05)
            optimizer.fit(A, p.y[:, None])
        x = np.asarray(optimizer.coef_).ravel()
        left = p.y - A @ x
        bic = n * math.log(p.rest + float(left @ left)) + np.count_nonzero(x) * math.log(n)
        if bic < best:
            best, found = bic, x
    weight: dict[str, float] = {}
    for name, x in zip(owner, found, strict=True):
        if x:
            weight[name] = math.hypot(weight.get(name, 0.0), x)
    return sorted(weight, key=lambda k: -weight[k])[:MOST]


def ridge(problem: Regression) -> list[str]:
    """All terms at once with a small ridge; names by their largest t value, from four on."""
    p = project(problem)
    A, owner = np.hstack(list(p.terms.values())), p.owners()
    inverse = np.linalg.inv(A.T @ A + 1e-2 * np.eye(A.shape[1]))
    x = inverse @ (A.T @ p.y)
    left = p.y - A @ x
    variance = WINDOW * (p.rest + float(left @ left)) / p.rows
    t = np.abs(x) / np.sqrt(np.diag(inverse) * variance)
    weight = {k: max(v for o, v in zip(owner, t, strict=True) if o == k) for k in p.terms}
    return [k for k in sorted(weight, key=lambda k: -weight[k]) if weight[k] > 4.0][:MOST]


METHODS: dict[str, Namer] = {
    "forward likelihood ratio": forward,
    "pysindy STLSQ": stlsq,
    "pysindy STLSQ, weak form": weak,
    "ridge of everything": ridge,
}


def screened(folder: Path, case: str) -> list[str] | None:
    """The tool's screening before any refit: its best score, if below 0.01; None without."""
    path = folder / "results" / case / "diagnosis.json"
    if not path.exists():
        return None
    listed = json.loads(path.read_text(encoding="utf-8")).get("screening") or []
    listed = [s for s in listed if s.get("p_value") is not None and s.get("score") is not None]
    if not listed:
        return None
    best = min(listed, key=lambda s: (s["p_value"], -s["score"]))
    return [best["name"].split(":")[0]] if best["p_value"] < 0.01 else []


def run(folder: Path) -> list[dict]:
    """Names of every method for the cases that the tool has diagnosed, as rows for score.py."""
    from .score import share

    plan = json.loads((folder / "sealed" / "plan.json").read_text(encoding="utf-8"))["cases"]
    plan = [c for c in plan if (folder / "results" / c["id"] / "run.json").exists()]
    names: dict[str, dict[str, list[str]]] = {m: {} for m in ("score test", *METHODS)}
    for i, case in enumerate(plan):
        here = folder / "cases" / case["id"]
        problem = regression(here, sorted((here / "train").glob("*.csv")))
        for method, namer in METHODS.items():
            names[method][case["id"]] = namer(problem)
        if (found := screened(folder, case["id"])) is not None:
            names["score test"][case["id"]] = found
        if i % 20 == 19:
            print(f"{i + 1} of {len(plan)} cases", flush=True)
    rows = []
    for method, of in names.items():
        done = [c for c in plan if c["id"] in of]
        single = [c for c in done if c["stratum"] == "single"]
        true = lambda c: c["effects"][0]["key"].split(":")[0]
        rows.append({
            "method": method,
            "top": share(of[c["id"]][:1] == [true(c)] for c in single),
            "set": share(true(c) in of[c["id"]] for c in single),
            "alarm": share(bool(of[c["id"]]) for c in done if c["stratum"] in ("clean", "benign")),
            "names": of,
        })  # fmt: skip
    return rows


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--set", default="develop")
    parser.add_argument("--out", type=Path, help="folder of the set (default: out/concealed/SET)")
    args = parser.parse_args()
    folder = args.out or Path("out/concealed") / args.set
    rows = run(folder)
    (folder / "baselines.json").write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    from .report import percent

    for row in rows:
        print(f"{row['method']:26} {percent(row['top'])}; {percent(row['set'])}; "
              f"{percent(row['alarm'])}")  # fmt: skip


if __name__ == "__main__":
    main()
