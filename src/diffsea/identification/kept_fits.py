"""Fits that are kept as they end, so that work which was killed goes on from there.

A fit lies in a file named by the hash of all that it follows from: data, vessel, what is free,
where it starts, versions, this package's source. Whoever does the same again finds it there, to
the last bit.
"""

import contextlib
import contextvars
import dataclasses
import functools
import hashlib
import importlib.metadata
import math
import re
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np

import diffsea
from diffsea.identification.estimates import Estimate, FitOutcome
from diffsea.identification.filter.covariance import Noise
from diffsea.identification.problem import Problem
from diffsea.outside.durable import written_beside
from diffsea.outside.unfinished import clear_abandoned
from diffsea.progress import PartialProgress, Progress, Remark, no_progress


_ADDRESS = re.compile(r" at 0x[0-9a-f]+")  # of a function, which differs from run to run
_NUMBERS = (
    *("coordinates", "deviance", "index", "covariance", "information", "precision"),
    *("shrinkage", "inflation", "path", "left_out"),
)
_DAMAGED = (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile)


@dataclasses.dataclass(frozen=True)
class KeptFit:
    """A fit, and what it said on its way."""

    fit: Estimate
    said: list[str]  # some of them `PartialProgress`


class KeptFits:
    """The fits of some work in a folder, which is made with the first of them."""

    def __init__(self, folder: Path, tell: Progress = no_progress):
        """Nothing is written yet. `tell` is told that fits were there, or that none can be kept."""
        self.folder, self.tell = folder, tell
        self.found = 0  # fits of earlier work that were taken
        self._own = set[Path]()  # files of this work, which asks for some fits again
        self.writes = True

    def get(
        self, problem: Problem, settings: Any, fit: Callable[[Progress], Estimate], to: Progress
    ) -> Estimate:
        """The fit of these settings, if it was kept; else a new one, which is kept if it ended.

        What it says on its way goes `to` whoever follows, in either case.
        """
        file = self.folder / f"fit-{_key(problem, settings)}.npz"
        if (kept := _read(file)) is not None:
            if file not in self._own and not self.found:
                self.tell(Remark(f"fits that were done before are taken from {self.folder}"))
            self.found += file not in self._own
            for message in kept.said:
                to(message)
            return kept.fit
        said: list[str] = []

        def follow(message: str) -> None:
            said.append(message)
            to(message)

        made = fit(follow)
        if self.writes and made.outcome is not FitOutcome.OUT_OF_TIME:
            self._own.add(file)
            self._write(file, KeptFit(made, said))
        return made

    def _write(self, file: Path, made: "KeptFit") -> None:
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with written_beside(file) as beside, beside.open("wb") as opened:
                np.savez(opened, allow_pickle=False, **_as_arrays(made))
        except OSError as error:
            self.writes = False
            told = f"fits are not kept: cannot write {error.filename or file}: {error.strerror}"
            self.tell(Remark(told))

    def remove(self) -> None:
        """Remove what was kept, and the folder if nothing else lies there; as far as possible."""
        if not self.folder.is_dir():
            return
        with contextlib.suppress(OSError):  # it holds what others have put there, or is not ours
            for file in self.folder.glob("fit-*.npz"):
                file.unlink(missing_ok=True)
            clear_abandoned(self.folder)
            self.folder.rmdir()


_current: contextvars.ContextVar[KeptFits | None] = contextvars.ContextVar("kept", default=None)


@contextlib.contextmanager
def fits_kept(folder: Path | str, tell: Progress = no_progress) -> Iterator[KeptFits]:
    """Keep the fits of the innovation likelihood that are made within, and take those kept before.

        with diffsea.fits_kept("boat-parts"):
            found = diffsea.diagnose("boat.toml", runs)

    They stay in the folder if the work is killed or interrupted, and are removed once it has ended:
    then its results are what is kept. What has a time of its own (`budget`) keeps no fit that was
    cut short.
    """
    kept = KeptFits(Path(folder), tell)
    token = _current.set(kept)
    try:
        yield kept
    except Exception:
        kept.remove()
        raise
    else:
        kept.remove()
    finally:
        _current.reset(token)


def kept_fit(
    problem: Problem, settings: Any, fit: Callable[[Progress], Estimate], progress: Progress
) -> Estimate:
    """A fit as it was kept, or made and kept, where fits are; a new one elsewhere.

    Arguments:
        settings: all that it depends on besides the problem: a tree of arrays, numbers and text.
    """
    kept = _current.get()
    if kept is None or not (problem.further is None or isinstance(problem.further, eqx.Module)):
        return fit(progress)
    return kept.get(problem, settings, fit, progress)


def _key(problem: Problem, settings: Any) -> str:
    """A hash of a problem, of the settings of a fit, and of the versions by which it is made."""
    leaves, structure = jax.tree.flatten(
        (problem.base, problem.dataset, problem.prior, problem.further, settings)
    )
    layout = problem.layout
    effects = tuple(effect.name for effect in layout.effects)
    plain = layout.parameters, effects, layout.sizes, layout.runs, layout.per_run, layout.latest
    versions = [importlib.metadata.version(name) for name in ("diffsea", "jaxlib", "numpy")]
    key = hashlib.sha256(_plain((structure, plain, versions, _source_digest())))
    for leaf in leaves:
        key.update(_plain(leaf) if isinstance(leaf, str) else _bits(leaf))
    return key.hexdigest()[:32]


@functools.cache
def _source_digest() -> str:
    """A hash of the package's source: another one may end fits elsewhere, by the same version."""
    total = hashlib.sha256()
    for path in sorted(Path(diffsea.__file__).parent.rglob("*.py")):
        total.update(path.read_bytes())
    return total.hexdigest()


def _plain(value: Any) -> bytes:
    return _ADDRESS.sub("", repr(value)).encode()


def _bits(leaf: Any) -> bytes:
    array = np.asarray(leaf)
    return _plain((array.dtype.str, array.shape)) + array.tobytes()


def _as_arrays(kept: KeptFit) -> dict[str, np.ndarray]:
    """A fit as arrays of numbers and text."""
    fit, shares = kept.fit, [getattr(message, "share", math.nan) for message in kept.said]
    named = {name: np.asarray(getattr(fit, name)) for name in _NUMBERS}
    return named | {
        "free": np.array(fit.free, str),
        "noise": np.asarray(fit.noise.scales),
        "outcome": np.array(fit.outcome.value),
        "said": np.array([str(message) for message in kept.said], str),
        "shares": np.array(shares, float),
    }


def _read(file: Path) -> KeptFit | None:
    """A fit that was kept; None where there is none, or its file is damaged."""
    try:
        with file.open("rb") as opened, np.load(opened, allow_pickle=False) as read:
            found = {name: read[name] for name in read.files}
        fit = Estimate(
            free=tuple(map(str, found["free"])),
            coordinates=found["coordinates"],
            deviance=float(found["deviance"]),
            index=found["index"],
            covariance=found["covariance"],
            information=found["information"],
            precision=found["precision"],
            shrinkage=found["shrinkage"],
            inflation=float(found["inflation"]),
            state=Noise.of(found["noise"]),
            path=tuple(found["path"].tolist()),
            outcome=FitOutcome(str(found["outcome"])),
            left_out=found["left_out"],
        )
        told = zip(map(str, found["said"]), map(float, found["shares"]), strict=True)
        said = [text if math.isnan(share) else PartialProgress(text, share) for text, share in told]
        return KeptFit(fit, said)
    except _DAMAGED:
        return None
