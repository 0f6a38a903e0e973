"""Actuators of recordings of which the motion is known, but not what drives the vessel.

Topics of a robot's orders may have any name and any message, and a table with native columns of
motion foreign ones of orders: these are guessed as those of foreign tables are.
"""

import contextlib
import dataclasses
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from diffsea.errors import UserError
from diffsea.recordings import logs
from diffsea.recordings.known import Recognised
from diffsea.recordings.mapping_proposal.actuators import called_like_actuators, find_actuators
from diffsea.recordings.mapping_proposal.guesses import ChannelGuess, actuator_guesses, level
from diffsea.recordings.mapping_proposal.names import suggest_labels
from diffsea.recordings.mapping_proposal.table_layout import sniff_layout
from diffsea.recordings.mappings import Column, Mapping, is_channel
from diffsea.recordings.readers import read_recording
from diffsea.trajectory import Trajectory


_OF_ANY_TOPICS = ("ros-bag", "mcap-json")  # formats whose topics anybody names
_MOST_READ = 3  # logs that are asked


def with_guessed_actuators(
    known: dict[Path, Recognised],
) -> dict[Path, tuple[Recognised, tuple[str, ...]]]:
    """Logs without known actuators with those that names and motion tell, and what is but guessed.

    Logs in which the same channels are in the same columns are asked together.
    """
    groups: dict[tuple, list[Path]] = {}
    for path, one in known.items():
        driven = any(name.startswith(("cmd_", "exec_")) for name in one.mapping.channels)
        if one.log in _OF_ANY_TOPICS and not driven:
            columns = _possible_columns(path, one)
            groups.setdefault((tuple(one.mapping.channels.items()), columns), []).append(path)
    found = {}
    for (_, columns), paths in groups.items():
        guesses = _guesses(paths, known[paths[0]].mapping, columns)
        if guesses:
            doubtful = _doubtful(guesses)
            found |= {path: (_with_channels(known[path], guesses), doubtful) for path in paths}
    return found


def native_with_guessed_actuators(
    paths: Iterable[Path],
) -> dict[Path, tuple[Mapping, tuple[str, ...], tuple[str, ...]]]:
    """Mappings of tables with native columns but for those that drive the vessel.

    With a sentence for each guess, and those of what is no more than guessed.
    """
    groups: dict[tuple[str, ...], list[Path]] = {}
    for path in paths:
        with contextlib.suppress(UserError):
            if not logs.is_log(path):
                groups.setdefault(sniff_layout(path).names, []).append(path)
    found = {}
    for names, group in groups.items():
        native = [name for name in names if is_channel(name)]
        if any(name.startswith(("cmd_", "exec_")) for name in native):
            continue
        channels = {name: Column(name) for name in native}
        mapping = Mapping(channels, "native columns and guessed ones")
        foreign = [name for name in names if name not in channels]
        guesses = _guesses(group, mapping, called_like_actuators(foreign))
        if guesses:
            mapping = _mapping_with(mapping, guesses)
            found |= dict.fromkeys(group, (mapping, _sentences(guesses), _doubtful(guesses)))
    return found


def _possible_columns(path: Path, known: Recognised) -> tuple[str, ...]:
    """Columns of topics without motion that are called like actuators."""
    of_motion = {one.topic_and_field[0] for one in known.mapping.channels.values()}
    return tuple(
        called_like_actuators(
            f"{topic}:{field}"
            for topic, fields in logs.contents(path).items()
            for field in fields
            if topic not in of_motion
        )
    )


def _guesses(
    paths: Sequence[Path], motion: Mapping, columns: Sequence[str]
) -> tuple[ChannelGuess, ...]:
    """What drives the vessel of recordings whose motion is read through a mapping."""
    read = [_with_orders(path, motion, columns) for path in paths[:_MOST_READ] if columns]
    runs = [run for run in read if run is not None]
    kept = [name for name in columns if all(_is_told(run, name) for run in runs)]
    if not runs or not kept:
        return ()
    runs = [
        dataclasses.replace(run, commanded={name: run.commanded[name] for name in kept})
        for run in runs
    ]
    suggestions = {name: suggest_labels(name) for name in kept}
    return tuple(actuator_guesses(find_actuators(runs, suggestions, [])))


def _with_orders(path: Path, motion: Mapping, columns: Sequence[str]) -> Trajectory | None:
    """A recording with those columns as orders that can be read; None where its motion cannot."""

    def read(*names: str) -> Trajectory | None:
        orders = {f"cmd_{name}": Column(name) for name in names}
        with contextlib.suppress(UserError):  # its own check will say what is wrong
            mapping = dataclasses.replace(motion, channels=motion.channels | orders)
            return read_recording(path, mapping)
        return None

    whole = read(*columns)
    if whole is not None or len(columns) == 1:
        return whole
    return read(*(name for name in columns if read(name) is not None))


def _is_told(run: Trajectory, order: str) -> bool:
    """Whether a run has values of an order."""
    return order in run.commanded and bool(np.isfinite(run.commanded[order]).any())


def _with_channels(known: Recognised, guesses: Sequence[ChannelGuess]) -> Recognised:
    """The log with guessed channels, which are said to be guessed."""
    found = {"orders"} if any(one.channel.startswith("cmd_") for one in guesses) else set[str]()
    return dataclasses.replace(
        known,
        mapping=_mapping_with(known.mapping, guesses),
        missing={group: text for group, text in known.missing.items() if group not in found},
        guessed=_sentences(guesses),
    )


def _mapping_with(mapping: Mapping, guesses: Sequence[ChannelGuess]) -> Mapping:
    channels = mapping.channels | {one.channel: one.column for one in guesses}
    return dataclasses.replace(mapping, channels=channels)


def _sentences(guesses: Sequence[ChannelGuess]) -> tuple[str, ...]:
    return tuple(f"{level(one.sure)}: {one.sentence}" for one in guesses)


def _doubtful(guesses: Sequence[ChannelGuess]) -> tuple[str, ...]:
    """What is no more than guessed."""
    return tuple(one.sentence for one in guesses if level(one.sure) == "guess")
